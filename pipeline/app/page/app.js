// The page of `trueroll app`.
import { html, useEffect } from "./html.js";
import { followServer, library } from "./library_store.js";
import { Notices } from "./parts/notices.js";
import { routeTo, useRoute } from "./router.js";
import { useStore } from "./store.js";
import { text } from "./strings.js";
import { render } from "./vendor/preact.js";
import { LibraryView } from "./views/library.js";
import { PhoneView } from "./views/phone.js";
import { SessionView } from "./views/session.js";
import { ShotView } from "./views/shot.js";

const VIEWS = { library: LibraryView, shot: ShotView, session: SessionView, phone: PhoneView };

function App() {
  const route = useRoute();
  const { isOnline, lan, local } = useStore(library);
  useEffect(followServer, []);
  useEffect(() => {
    if (route.view === "library") document.title = text.app.title;
    scrollTo(0, 0);
  }, [route.view, route.id]);
  const View = VIEWS[route.view];
  return html`
    <a class="skip" href="#main"
      onClick=${(event) => { event.preventDefault(); document.getElementById("main").focus(); }}>${text.app.skip}</a>
    <header class="bar">
      <a class="brand" href=${routeTo("library")}><img src="icon.svg" alt="" width="28" height="28" />${text.app.name}</a>
      <nav aria-label=${text.app.views}>
        <a href=${routeTo("library")} aria-current=${route.view === "library" ? "page" : undefined}>${text.library.title}
          </a>
        ${lan && local && html`<a href=${routeTo("phone")}
          aria-current=${route.view === "phone" ? "page" : undefined}>${text.phone.title}</a>`}
      </nav>
    </header>
    ${!isOnline && html`<p class="offline" role="alert">${text.errors.offline}</p>`}
    <main id="main" tabindex="-1"><${View} key=${route.id} id=${route.id} /></main>
    <${Notices} />`;
}

render(html`<${App} />`, document.body);
