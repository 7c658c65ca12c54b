// The clips that are uploaded, wait or run, and what is known of them so far.
import { html, useState } from "../html.js";
import { actOnJob, library } from "../library_store.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";
import { routeToCard } from "./card_grid.js";
import { CornersDialog } from "./corners_dialog.js";

// Steps that people see, with the stages that each consists of.
const STEPS = [
  ["read", ["read"]], ["table", ["calibrate"]], ["balls", ["detect", "place"]], ["tracks", ["track"]], ["motion", ["motion", "explain", "fit"]],
  ["report", ["background", "poster", "page", "export", "report", "forecast", "record"]], ["video", ["render"]],
];
const RUNNING = ["checking", "running"];
const ENDED = ["done", "cancelled"];
// Remedies of a failure that the corners of the table or court are, or help with.
const NEED_CORNERS = ["corners", "court corners", "balls"];

export function Queue({ jobs, waiting }) {
  const open = jobs.filter((job) => !ENDED.includes(job.state));
  const done = jobs.filter((job) => job.state === "done").slice(-3);
  if (!open.length && !waiting.length && !done.length) return null;
  const running = open.filter((job) => RUNNING.includes(job.state));
  const rest = open.filter((job) => !RUNNING.includes(job.state));
  return html`<section class="queue" aria-label=${text.queue.title}>
    ${waiting.map((upload) => html`<div class="job small-job" key=${`upload ${upload.id}`}>
      <p class="job-name">${upload.name}</p>
      <progress value=${upload.share} max="1" aria-label=${text.queue.uploading(upload.name)}></progress>
    </div>`)}
    ${running.map((job) => html`<${RunningJob} key=${job.id} job=${job} />`)}
    ${[...rest, ...done].map((job) => html`<${SmallJob} key=${job.id} job=${job} />`)}
  </section>`;
}

/** The card of the result of a job; undefined until there is one. */
function useCard(job) {
  const { shots } = useStore(library);
  return shots?.find((one) => one.id === job.shot);
}

function RunningJob({ job }) {
  const card = useCard(job);
  return html`<article class="job running-job" aria-label=${text.queue.runs(job.name)}>
    <div class="preview">${job.preview
      ? html`<img src=${`api/jobs/${job.id}/preview?r=${job.preview_revision ?? job.share}`}
        alt=${text.queue.preview(job.name)} />`
      : html`<span class="no-thumb">${text.queue.noPreview}</span>`}</div>
    <div class="job-words">
      <div class="job-head"><h2>${job.name}</h2>
        <button onClick=${() => actOnJob(job.id, "cancel")}>${text.queue.cancel}</button></div>
      <${CheckSentences} check=${job.check} />
      <${StepLine} job=${job} />
      ${card?.outcome && html`<p class="headline">${card.outcome}</p>`}
      <ul class="found" aria-live="polite">${(job.found ?? []).map((sentence) => html`<li key=${sentence}>${sentence}
        </li>`)}</ul>
      ${job.shot && html`<p><a class="button main" href=${routeToCard(card ?? { id: job.shot })}>${text.queue.look}</a></p>`}
    </div>
  </article>`;
}

function CheckSentences({ check }) {
  if (!check?.sentences?.length) return null;
  const [first, ...others] = check.sentences;
  return html`<div class="check ${check.level ?? ""}">
    <p>${first}</p>
    ${others.length > 0 && html`<details><summary>${text.queue.more(others.length)}</summary>
      <ul>${others.map((sentence) => html`<li key=${sentence}>${sentence}</li>`)}</ul></details>`}
  </div>`;
}

function StepLine({ job }) {
  const found = STEPS.findIndex(([, stages]) => stages.includes(job.stage));
  if (found < 0 && job.state === "running") { // a command, or one of the shots of a recording
    return html`<div><progress aria-label=${text.queue.runs(job.name)} value=${job.share || undefined} max="1"></progress><p>${job.stage}</p></div>`;
  }
  const at = Math.max(0, found);
  const name = text.queue.steps[STEPS[at][0]];
  return html`<div class="steps">
    <ol aria-hidden="true">${STEPS.map(([step], k) => html`<li key=${step} class=${k < at ? "past" : k === at ? "now" : ""}>
      <span class="track"><span style=${{ width: `${100 * (k < at ? 1 : k === at ? job.share ?? 0 : 0)}%` }}></span></span>
      <span class="step-name">${text.queue.steps[step]}</span></li>`)}</ol>
    <p class="hidden" role="status">${job.state === "checking" ? text.queue.checking : text.queue.step(name, at + 1, STEPS.length)}</p>
  </div>`;
}

function SmallJob({ job }) {
  const card = useCard(job);
  const [isMarking, setIsMarking] = useState(false);
  const notes = job.action ? job.found ?? [] : [];
  return html`<div class="job small-job ${job.state}">
    <div class="job-name">${!job.error?.startsWith(job.name) && html`<span>${job.name}</span>`}<span class="job-state">${job.error || card?.outcome || text.queue.states[job.state]}</span>
      ${notes.length > 0 && html`<details><summary>${text.queue.notes(notes.length)}</summary>
        <ul>${notes.map((one) => html`<li key=${one}>${one}</li>`)}</ul></details>`}</div>
    ${job.state === "failed" && job.preview && NEED_CORNERS.includes(job.remedy) && html`<button class="main"
      onClick=${() => setIsMarking(true)}>${text.queue.corners}</button>`}
    ${isMarking && html`<${CornersDialog} job=${job} onClose=${() => setIsMarking(false)} />`}
    ${job.state === "waiting" && html`<button onClick=${() => actOnJob(job.id, "cancel")}>${text.queue.cancel}</button>`}
    ${job.state === "failed" && html`<button onClick=${() => actOnJob(job.id, "retry")}>${text.queue.retry}</button>`}
    ${job.state === "failed" && html`<button class="plain" onClick=${() => actOnJob(job.id, "dismiss")}>${text.queue.forget}
      </button>`}
    ${job.shot && html`<a class="button" href=${routeToCard(card ?? { id: job.shot })}>${text.queue.open}</a>`}
  </div>`;
}
