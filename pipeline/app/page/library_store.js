// The library as this page knows it: shots, jobs and disk of the server, uploads and notices of this page.
import { RequestError, listen, post, read, remove, send, uploadClip } from "./api.js";
import { createStore } from "./store.js";
import { text } from "./strings.js";

// ms that a notice stays, and one that offers to undo.
const NOTICE_MS = 6000;
const UNDO_MS = 15000;
const ENDED = ["done", "failed", "cancelled"];

export const library = createStore({
  shots: /** @type {object[] | null} */ (null), jobs: [], disk: null, revision: -1, lan: false, local: true, isOnline: true,
  preparing: "",
});
export const uploads = createStore({ waiting: [] });
export const notices = createStore({ list: [] });
/** Number of changes of a shot that the server has announced, by its id. */
export const shotChanges = createStore({});

let lastNotice = 0;

/**
 * Show a sentence for a while.
 * @param {string} sentence
 * @param {{kind?: "error", action?: {label: string, run: () => void}}} options
 */
export function notify(sentence, { kind = "", action } = {}) {
  lastNotice += 1;
  const id = lastNotice;
  const others = notices.get().list.filter((one) => one.sentence !== sentence).slice(-3);
  notices.set({ list: [...others, { id, sentence, kind, action }] });
  setTimeout(() => dismiss(id), action ? UNDO_MS : NOTICE_MS);
}

export const dismiss = (id) => notices.set(({ list }) => ({ list: list.filter((one) => one.id !== id) }));
export const notifyError = (error) => { if (error.name !== "AbortError") notify(error.message, { kind: "error" }); };

let isLoading = false;
let isStale = false;

/** Read the library again; calls while a reading is under way are one more reading after it. */
export async function loadLibrary() {
  isStale = true;
  if (isLoading) return;
  isLoading = true;
  try {
    while (isStale) {
      isStale = false;
      library.set({ ...await read("api/library"), isOnline: true });
    }
  } catch (error) {
    library.set({ isOnline: false });
  } finally {
    isLoading = false;
  }
}

function handleEvent(event) {
  if (event.type === "library" && event.revision !== library.get().revision) loadLibrary();
  if (event.type === "job") {
    putJob(event);
    if (ENDED.includes(event.state)) loadLibrary(); // its card is no longer one of a running job
  }
  if (event.type === "preparing") library.set({ preparing: event.preparing });
  if (event.type === "shot") shotChanges.set((counts) => ({ [event.id]: (counts[event.id] ?? 0) + 1 }));
}

function putJob({ type, ...job }) {
  const { jobs } = library.get();
  const isKnown = jobs.some((one) => one.id === job.id);
  library.set({ jobs: isKnown ? jobs.map((one) => (one.id === job.id ? { ...one, ...job } : one)) : [...jobs, job] });
}

/** Follow the server: events while it runs, and the whole library whenever the connection opens again. */
export function followServer() {
  loadLibrary();
  return listen(handleEvent, (isOpen) => {
    if (isOpen) loadLibrary();
    else library.set({ isOnline: false });
  });
}

let nextUpload = 0;

/** Upload files one after the other. */
export async function addFiles(files) {
  const rows = [...files].map((file) => ({ id: (nextUpload += 1), file, name: file.name, share: 0 }));
  if (!rows.length) notify(text.library.nothingDropped, { kind: "error" });
  uploads.set(({ waiting }) => ({ waiting: [...waiting, ...rows] }));
  if (uploads.get().waiting.length > rows.length) return; // the loop below is running already
  for (let row = rows[0]; row; row = uploads.get().waiting[0]) {
    const { id } = row;
    const change = (part) => {
      uploads.set(({ waiting }) => ({ waiting: waiting.map((one) => (one.id === id ? { ...one, ...part } : one)) }));
    };
    try {
      const most = library.get().limits?.upload_bytes ?? Infinity;
      if (row.file.size > most) throw new RequestError(text.errors.tooLarge(row.name, most), 413);
      const { jobs } = await uploadClip(row.file, (share) => change({ share }));
      jobs.forEach(putJob);
    } catch (error) {
      notifyError(error.message.includes(row.name) ? error : new RequestError(text.errors.ofFile(row.name, error.message), 0));
    }
    uploads.set(({ waiting }) => ({ waiting: waiting.filter((one) => one.id !== id) }));
  }
}

/** Queue a clip or a folder of this machine. */
export async function addPath(path) {
  (await post("api/paths", { path })).jobs.forEach(putJob);
}

export const actOnJob = (id, action) => post(`api/jobs/${id}/${action}`).then(loadLibrary).catch(notifyError);

/** Delete shots, and offer to undo that. */
export async function deleteShots(ids) {
  const undone = [];
  for (const id of ids) {
    try {
      undone.push((await remove(`api/shots/${encodeURIComponent(id)}`)).undo);
    } catch (error) {
      notifyError(error);
    }
  }
  if (undone.length) {
    notify(text.library.deleted(undone.length), {
      action: { label: text.library.undoDelete, run: () => restoreShots(undone) },
    });
  }
  await loadLibrary();
}

/** Rename a shot, and offer to undo that. */
export async function renameShot(id, name, canUndo = true) {
  const { shot, before } = await send("PUT", `api/shots/${encodeURIComponent(id)}/name`, { body: { name } });
  if (canUndo) {
    notify(text.library.renamed(name), {
      action: { label: text.library.undoDelete, run: () => renameShot(shot, before, false).catch(notifyError) },
    });
  }
  await loadLibrary();
}

/** Restore shots from the trash by the tokens of their deletion. */
export async function restoreShots(tokens) {
  for (const token of tokens) await post(`api/trash/${token}/restore`).catch(notifyError);
  await loadLibrary();
}

export async function emptyTrash() {
  await remove("api/trash").catch(notifyError);
  await loadLibrary();
}

/** Queue a command on several shots. */
export async function startSession(action, shots) {
  const { job } = await post("api/sessions", { action, shots });
  if (job) putJob(job);
}
