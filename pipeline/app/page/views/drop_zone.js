// Where clips come in: dropped, chosen, or as a path of this machine.
import { html, useEffect, useRef, useState } from "../html.js";
import { addFiles, addPath, library, notifyError } from "../library_store.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function DropZone({ isLarge }) {
  const { local } = useStore(library);
  const [isOver, setIsOver] = useState(false);
  const chooser = useRef(null);
  useEffect(() => acceptDrops(setIsOver), []);
  return html`<section class="drop ${isLarge ? "large" : ""} ${isOver ? "over" : ""}" aria-label=${text.drop.title}>
    <div class="drop-here">
      <svg viewBox="0 0 48 48" width="48" height="48" aria-hidden="true"><path d="M24 6v24m-9-9 9 9 9-9M8 34v6h32v-6"
        fill="none"
        stroke="currentColor" stroke-width="3" stroke-linecap="round" stroke-linejoin="round" /></svg>
      <p class="drop-title">${isOver ? text.drop.release : text.drop.here}</p>
      <button class="main" onClick=${() => chooser.current.click()}>${text.drop.choose}</button>
      <input ref=${chooser} id="chooser" type="file" accept="video/*" multiple hidden aria-label=${text.drop.choose}
        onChange=${(event) => { addFiles(event.target.files); event.target.value = ""; }} />
    </div>
    ${isLarge && html`<p class="drop-hint">${text.drop.hint}</p>`}
    ${local && html`<${PathForm} />`}
  </section>`;
}

function PathForm() {
  const [path, setPath] = useState("");
  const [isBusy, setIsBusy] = useState(false);
  const submit = async (event) => {
    event.preventDefault();
    const wanted = path.trim().replace(/^(["'])(.*)\1$/, "$2"); // as file managers copy a path
    if (!wanted) return;
    setIsBusy(true);
    await addPath(wanted).then(() => setPath("")).catch(notifyError);
    setIsBusy(false);
  };
  return html`<form class="path" onSubmit=${submit}>
    <label for="path">${text.drop.path}</label>
    <input id="path" value=${path} placeholder=${text.drop.pathExample} autocomplete="off" spellcheck=${false}
      onInput=${(event) => setPath(event.target.value)} />
    <button disabled=${isBusy || !path.trim()}>${text.drop.add}</button>
  </form>`;
}

/** Take files that are dropped anywhere on the page; `setIsOver` says whether some are over it. */
function acceptDrops(setIsOver) {
  let depth = 0; // the events of elements inside each other overlap
  const holdsFiles = (event) => event.dataTransfer?.types.includes("Files");
  const handlers = {
    dragenter: (event) => { if (holdsFiles(event)) { event.preventDefault(); depth += 1; setIsOver(true); } },
    dragover: (event) => { if (holdsFiles(event)) event.preventDefault(); },
    dragleave: (event) => { if (holdsFiles(event)) { depth = Math.max(0, depth - 1); setIsOver(depth > 0); } },
    drop: async (event) => {
      if (!holdsFiles(event)) return;
      event.preventDefault();
      depth = 0;
      setIsOver(false);
      addFiles(await listDroppedFiles(event.dataTransfer));
    },
  };
  for (const [name, handler] of Object.entries(handlers)) addEventListener(name, handler);
  return () => { for (const [name, handler] of Object.entries(handlers)) removeEventListener(name, handler); };
}

/** List the files of a drop, those in dropped folders included. */
async function listDroppedFiles(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()); // all at once: they vanish with the event
  if (!entries.some((entry) => entry?.isDirectory)) return [...transfer.files];
  return (await Promise.all(entries.filter(Boolean).map(listEntryFiles))).flat()
    .filter((file) => file.type.startsWith("video/") || !file.type);
}

async function listEntryFiles(entry) {
  if (entry.isFile) return [await new Promise((resolve, reject) => entry.file(resolve, reject))];
  const reader = entry.createReader();
  const files = [];
  for (;;) { // one call returns a part of a large folder only
    const part = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (!part.length) return files.filter((file) => !file.name.startsWith("."));
    files.push(...(await Promise.all(part.map(listEntryFiles))).flat());
  }
}
