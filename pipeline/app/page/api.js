// Requests to the server. Every address is relative to that of the page, which holds the token.
import { text } from "./strings.js";

/** The server refused a request; the message is its sentence. */
export class RequestError extends Error {
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

/**
 * Send a request and read its JSON answer.
 * @param {string} method
 * @param {string} path
 * @param {{body?: unknown, headers?: Record<string, string>, signal?: AbortSignal}} options
 */
export async function send(method, path, { body, headers = {}, signal } = {}) {
  let answer;
  try {
    answer = await fetch(path, {
      method, signal,
      headers: body === undefined ? headers : { ...headers, "Content-Type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new RequestError(text.errors.noServer, 0);
  }
  const content = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new RequestError(content.error ?? text.errors.refused(answer.status), answer.status);
  return content;
}

export const read = (path, signal) => send("GET", path, { signal });
export const post = (path, body = {}, signal) => send("POST", path, { body, signal });
export const remove = (path) => send("DELETE", path);

/** Address of a file of a shot. */
export const fileAddress = (id, name) => `api/shots/${encodeURIComponent(id)}/file/${encodeURIComponent(name)}`;
export const shotAddress = (id, rest = "") => `api/shots/${encodeURIComponent(id)}${rest && `/${rest}`}`;

/**
 * Upload one clip; only XMLHttpRequest reports the progress of an upload.
 * @param {File} file
 * @param {(share: number) => void} onProgress
 */
export function uploadClip(file, onProgress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", `api/clips?name=${encodeURIComponent(file.name)}&modified=${file.lastModified}`);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.responseType = "json";
    request.upload.addEventListener("progress", (event) => event.lengthComputable && onProgress(event.loaded / event.total));
    request.addEventListener("error", () => reject(new RequestError(text.errors.uploadBroke(file.name), 0)));
    request.addEventListener("load", () => {
      if (request.status < 300) resolve(request.response);
      else reject(new RequestError(request.response?.error ?? text.errors.refused(request.status), request.status));
    });
    request.send(file);
  });
}

/**
 * Listen to the events of the server.
 * @param {(event: {type: string}) => void} onEvent
 * @param {(isOpen: boolean) => void} onConnection called when the connection opens, and when it is lost
 */
export function listen(onEvent, onConnection) {
  const source = new EventSource("api/events");
  source.addEventListener("message", (message) => onEvent(JSON.parse(message.data)));
  source.addEventListener("open", () => onConnection(true));
  source.addEventListener("error", () => onConnection(false));
  return () => source.close();
}
