// What lies in the trash: each shot can be restored, and all are deleted for good only from here.
import { html, useEffect, useRef, useState } from "../html.js";
import { read } from "../api.js";
import { emptyTrash, library, notifyError, restoreShots } from "../library_store.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function TrashDialog({ onClose }) {
  const { disk } = useStore(library);
  const [entries, setEntries] = useState(null);
  const dialog = useRef(null);
  const close = () => dialog.current?.close();
  const load = () => read("api/trash").then((content) => setEntries(content.entries))
    .catch((error) => { notifyError(error); close(); });
  useEffect(() => { dialog.current.showModal(); }, []);
  useEffect(() => { load(); }, [disk.trash_bytes]);
  const bytes = (entries ?? []).reduce((sum, one) => sum + one.bytes, 0);
  return html`<dialog ref=${dialog} class="files" aria-labelledby="trash-title" onClose=${onClose}><div class="dialog-body">
    <h2 id="trash-title">${text.trash.title}</h2>
    ${!entries ? html`<p role="status">${text.app.loading}</p>` : !entries.length ? html`<p>${text.trash.empty}</p>`
    : html`<ul>${entries.map((one) => html`<li key=${one.undo}><span class="file-name">${one.name}
        <small>${text.bytes(one.bytes)}</small></span>
        <button aria-label=${text.trash.restoreLabel(one.name)}
          onClick=${() => restoreShots([one.undo]).then(load)}>${text.trash.restore}</button></li>`)}</ul>
      <p>${text.trash.warning}</p>`}
    <div class="row"><button class="main" onClick=${close}>${text.app.close}</button>
      ${entries?.length > 0 && html`<button class="danger"
        onClick=${() => emptyTrash().then(close)}>${text.trash.empties(entries.length, bytes)}</button>`}</div>
  </div></dialog>`;
}
