// Give a shot another name, or the one back that it had before.
import { html, useEffect, useRef, useState } from "../html.js";
import { library, renameShot } from "../library_store.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function RenameDialog({ card, onClose }) {
  const [name, setName] = useState(card.folder);
  const [error, setError] = useState("");
  const { former_names: formerNames } = useStore(library);
  const former = formerNames?.[card.id];
  const dialog = useRef(null);
  const close = () => dialog.current?.close();
  useEffect(() => { dialog.current.showModal(); }, []);
  const rename = (wanted) => renameShot(card.id, wanted).then(close, (one) => setError(one.message));
  const submit = (event) => {
    event.preventDefault();
    rename(name.trim());
  };
  return html`<dialog ref=${dialog} class="files" aria-labelledby="rename-title" onClose=${onClose}>
    <form class="dialog-body" onSubmit=${submit}>
      <h2 id="rename-title">${text.library.renameTitle(card.name)}</h2>
      <div class="row"><label for="new-name">${text.library.newName}</label>
        <input id="new-name" value=${name} required maxlength="180" autocomplete="off" spellcheck=${false}
          onInput=${(event) => setName(event.target.value)} /></div>
      ${error && html`<p role="alert">${error}</p>`}
      <div class="row"><button class="main" disabled=${!name.trim() || name.trim() === card.folder}>${text.library.rename}</button>
        ${former && html`<button type="button" onClick=${() => rename(former)}>${text.library.formerName(former)}</button>`}
        <button type="button" onClick=${close}>${text.app.cancel}</button></div>
    </form></dialog>`;
}
