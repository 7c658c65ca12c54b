// The library: clips are dropped here, the queue runs here, shots are found here.
import { html, useMemo, useState } from "../html.js";
import { deleteShots, library, notify, notifyError, startSession, uploads } from "../library_store.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";
import { CardGrid, SHOTS } from "./card_grid.js";
import { DropZone } from "./drop_zone.js";
import { FilterBar } from "./filter_bar.js";
import { NO_FILTER, filterShots, indexShots } from "./library_filter.js";
import { Queue } from "./queue.js";
import { RenameDialog } from "./rename_dialog.js";
import { TrashDialog } from "./trash_dialog.js";

const SESSION_ACTIONS = ["compare", "certify", "diagnose"];

export function LibraryView() {
  const { shots, jobs, disk } = useStore(library);
  const { waiting } = useStore(uploads);
  const [filter, setFilter] = useState(NO_FILTER);
  const [chosen, setChosen] = useState(() => new Set());
  const index = useMemo(() => indexShots(shots ?? []), [shots]);
  const shown = useMemo(() => filterShots(index, filter), [index, filter]);
  const picked = (shots ?? []).filter((one) => chosen.has(one.id));
  const choose = (id, isChosen) => setChosen((before) => {
    const after = new Set(before);
    if (isChosen) after.add(id);
    else after.delete(id);
    return after;
  });
  if (!shots) return html`<p class="loading" role="status">${text.app.loading}</p>`;
  const isEmpty = !shots.length && !jobs.length && !waiting.length;
  return html`<div class="library">
    <h1 class=${isEmpty ? "hero-title" : "hidden"}>${isEmpty ? text.library.welcome : text.library.title}</h1>
    <${DropZone} isLarge=${isEmpty} />
    <${Queue} jobs=${jobs} waiting=${waiting} />
    ${shots.length > 0 && html`
      <${FilterBar} shots=${shots} filter=${filter} onChange=${setFilter} count=${shown.length} />
      <${CardGrid} cards=${shown} chosen=${chosen} onChoose=${choose} />
      ${!shown.length && html`<p class="nothing">${text.library.noMatch}
        <button onClick=${() => setFilter(NO_FILTER)}>${text.library.clearFilter}</button></p>`}`}
    ${(shots.length > 0 || disk?.trash_bytes > 0) && html`<${DiskLine} disk=${disk} />`}
    ${picked.length > 0 && html`<${SelectionBar} picked=${picked} onClear=${() => setChosen(new Set())} />`}
  </div>`;
}

function SelectionBar({ picked, onClear }) {
  const [isRenaming, setIsRenaming] = useState(false);
  const ids = picked.map((one) => one.id);
  const isOfShots = picked.every((one) => SHOTS.has(one.kind)); // pages that commands wrote can be deleted only
  const start = (action) => startSession(action, ids).then(() => {
    notify(text.library.started[action]);
    onClear();
    scrollTo({ top: 0, behavior: "smooth" });
  }).catch(notifyError);
  return html`<section class="selection-bar" aria-label=${text.library.selection}>
    <strong aria-live="polite">${text.library.selected(picked.length, isOfShots)}</strong>
    ${SESSION_ACTIONS.map((action) => html`<button key=${action} title=${text.library.actionHelp[action]}
      disabled=${!isOfShots || action === "compare" && ids.length < 2} onClick=${() => start(action)}>${text.library.actions[action]}
        </button>`)}
    ${isOfShots && picked.length === 1 && html`<button onClick=${() => setIsRenaming(true)}>${text.library.rename}</button>`}
    ${isRenaming && html`<${RenameDialog} card=${picked[0]} onClose=${() => setIsRenaming(false)} />`}
    <button class="danger" onClick=${() => deleteShots(ids).then(onClear)}>${text.library.delete}</button>
    <button class="plain" onClick=${onClear}>${text.library.clearSelection}</button>
  </section>`;
}

function DiskLine({ disk }) {
  const [isOpen, setIsOpen] = useState(false);
  if (!disk) return null;
  return html`<div class="disk">${text.library.disk(disk.used_bytes, disk.free_bytes)}
    ${disk.trash_bytes > 0 && html` <button class="plain" onClick=${() => setIsOpen(true)}>${text.trash.open(disk.trash_bytes)}
      </button>`}
    ${isOpen && html`<${TrashDialog} onClose=${() => setIsOpen(false)} />`}</div>`;
}
