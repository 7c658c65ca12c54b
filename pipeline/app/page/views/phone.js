// Let a phone in: a code that it reads with its camera, once.
import { html, useEffect, useState } from "../html.js";
import { post } from "../api.js";
import { text } from "../strings.js";

export function PhoneView() {
  const [pairing, setPairing] = useState(null);
  const [left, setLeft] = useState(0);
  const [error, setError] = useState("");
  const renew = () => post("api/lan/code").then((content) => { setPairing(content); setLeft(content.expires_s); setError(""); })
    .catch((one) => setError(one.message));
  useEffect(() => { document.title = text.phone.pageTitle; renew(); }, []);
  useEffect(() => {
    const timer = setInterval(() => setLeft((seconds) => Math.max(0, seconds - 1)), 1000);
    return () => clearInterval(timer);
  }, []);
  return html`<div class="phone"><h1>${text.phone.heading}</h1>
    ${error && html`<p role="alert">${error}</p>`}
    ${pairing && html`<ol><li>${text.phone.sameNetwork}</li><li>${text.phone.scan}</li><li>${text.phone.then}</li></ol>
      <div class=${`code ${left ? "" : "expired"}`}><img src=${`data:image/svg+xml,${encodeURIComponent(completeImage(pairing.svg))}`}
        alt=${text.phone.qr} width="240" height="240" />
        <p>${text.phone.orType}</p><p class="address">${pairing.address}</p></div>
      <p role="status">${left ? text.phone.expires(left) : text.phone.expired}</p>`}
    <p><button class="main" onClick=${renew}>${text.phone.renew}</button></p>
    <p class="small">${text.phone.safety}</p></div>`;
}

/** An image of its own names the namespace of SVG, which a part of a page does without. */
const completeImage = (svg) => new XMLSerializer().serializeToString(new DOMParser().parseFromString(svg, "text/html").querySelector("svg"));
