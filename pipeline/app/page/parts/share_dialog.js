// Make the files of a shot that one can send to somebody.
import { html, useEffect, useRef, useState } from "../html.js";
import { post } from "../api.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function ShareDialog({ shot, onClose }) {
  const { answer } = useStore(shot.desk);
  const [files, setFiles] = useState(null);
  const [error, setError] = useState("");
  const dialog = useRef(null);
  useEffect(() => {
    const request = new AbortController();
    dialog.current.showModal();
    post(shot.address("share"), answer?.verdict ? answer.asked : {}, request.signal)
      .then((content) => setFiles(content.files)).catch((one) => { if (one.name !== "AbortError") setError(one.message); });
    return () => request.abort();
  }, []);
  return html`<dialog ref=${dialog} class="files" aria-labelledby="share-title" onClose=${onClose}
      onClick=${(event) => { if (event.target === dialog.current) dialog.current.close(); }}>
    <div class="dialog-body">
      <h2 id="share-title">${text.share.title}</h2>
      ${error ? html`<p role="alert">${error}</p>` : !files ? html`<p role="status">${text.share.making}</p><progress
        aria-label=${text.share.making}></progress>`
        : html`<p>${text.share.ready}</p><ul>${files.map((file) => html`<${SharedFile} key=${file.name} file=${file}
          name=${`${shot.doc.name} ${file.name}`} />`)}
          </ul>`}
      <button class="main" onClick=${() => dialog.current.close()}>${text.app.close}</button>
    </div></dialog>`;
}

/** A file under a name that says of which shot it is, so that those of several shots do not collide. */
function SharedFile({ file, name }) {
  return html`<li><span class="file-name">${text.share.files(file.name)}
    <small>${name}${file.bytes ? ` · ${text.bytes(file.bytes)}` : ""}</small></span>
    <a class="button" href=${file.address} download=${name}>${text.share.save}</a>
    ${navigator.canShare && html`<button onClick=${() => sendFile(name, file.address)}>${text.share.send}</button>`}</li>`;
}

async function sendFile(name, address) {
  const content = await (await fetch(address)).blob();
  const files = [new File([content], name, { type: content.type })];
  if (navigator.canShare({ files })) await navigator.share({ files }).catch((error) => { if (error.name !== "AbortError") throw error; });
}
