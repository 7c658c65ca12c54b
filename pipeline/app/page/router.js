// The part of the address behind # decides which view is shown, so that a reload and a link lead to the same place.
import { useEffect, useState } from "./html.js";

const VIEWS = new Set(["shot", "session", "phone"]);

function parseRoute() {
  const [view, ...rest] = location.hash.replace(/^#\/?/, "").split("/");
  return VIEWS.has(view) ? { view, id: decodeURIComponent(rest.join("/")) } : { view: "library", id: "" };
}

export const routeTo = (view, id = "") => (view === "library" ? "#/" : `#/${view}${id && `/${encodeURIComponent(id)}`}`);

/** Return the shown view and the id of what it shows. */
export function useRoute() {
  const [route, setRoute] = useState(parseRoute);
  useEffect(() => {
    const update = () => setRoute(parseRoute());
    addEventListener("hashchange", update);
    return () => removeEventListener("hashchange", update);
  }, []);
  return route;
}
