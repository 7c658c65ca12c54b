// One shot: the video with its timeline, who hit what first, the plan, and below it what one may ask or correct.
import { html, useEffect, useMemo, useState } from "../html.js";
import { AnswerCard } from "../parts/answer_card.js";
import { AskForm } from "../parts/ask_form.js";
import { Plan } from "../parts/plan.js";
import { Preparing } from "../parts/preparing.js";
import { ShareDialog } from "../parts/share_dialog.js";
import { Stage } from "../parts/stage.js";
import { Timeline } from "../parts/timeline.js";
import { routeTo } from "../router.js";
import { handleShotKey } from "../shot/shot_keys.js";
import { ShotModel } from "../shot/shot_model.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";
import { CorrectSide, CorrectTab } from "../tabs/correct_tab.js";
import { NumbersTab } from "../tabs/numbers_tab.js";
import { PlacementTab } from "../tabs/placement_tab.js";
import { PlayTab } from "../tabs/play_tab.js";
import { StoryTab } from "../tabs/story_tab.js";
import { StrokesTab } from "../tabs/strokes_tab.js";
import { TrustMark } from "./card_grid.js";

const SHOT_TABS = { story: StoryTab, numbers: NumbersTab, play: PlayTab, placement: PlacementTab, correct: CorrectTab };
const RALLY_TABS = { story: StoryTab, strokes: StrokesTab, numbers: NumbersTab, correct: CorrectTab };
// Tabs beside which the plan shows what is tried; an answer is there only after a new question.
const TRYING = ["play", "placement"];
// Words for the levels of trust of a run.
const TRUST_LEVELS = { green: "high", amber: "medium", red: "low" };

/** Without its clip, a shot can be looked at but not corrected. */
function chooseTabs({ kind, clip }) {
  const tabs = kind === "rally" ? RALLY_TABS : SHOT_TABS;
  const { correct, ...others } = tabs;
  return clip === false ? others : tabs;
}

export function ShotView({ id }) {
  const shot = useMemo(() => new ShotModel(id), [id]);
  const { doc, error } = useStore(shot.state);
  const { tab, bodies } = useStore(shot.desk);
  const isTrying = TRYING.includes(tab);
  useEffect(() => { shot.load(); return () => shot.close(); }, [shot]);
  useEffect(() => { if (doc) document.title = text.shot.title(doc.name); }, [doc?.name]);
  useEffect(() => {
    const listener = (event) => { if (handleShotKey(shot, event)) event.preventDefault(); };
    document.addEventListener("keydown", listener);
    return () => document.removeEventListener("keydown", listener);
  }, [shot]);
  if (error) return html`<p class="nothing" role="alert">${error} <a href=${routeTo("library")}>${text.shot.back}</a></p>`;
  if (!doc || !shot.player) {
    return html`<div class="loading"><p role="status">${text.shot.loading}</p><${Preparing} /></div>`;
  }
  return html`<div class=${`shot ${tab}`}>
    <${ShotHead} shot=${shot} doc=${doc} />
    <div class="watch"><${Stage} shot=${shot} /><${Timeline} shot=${shot} /></div>
    <div class="know">${tab === "correct" ? html`<${CorrectSide} shot=${shot} />` : html`
      ${(!isTrying || bodies.length > 0) && html`<${AnswerCard} key="answer" shot=${shot} />`}
      ${doc.plan && html`<${Plan} key="plan" shot=${shot} />`}
      ${!isTrying && html`<${AskForm} key="ask" shot=${shot} />`}`}
    </div>
    <${Tabs} shot=${shot} tabs=${chooseTabs(doc)} />
  </div>`;
}

function ShotHead({ shot, doc }) {
  const [isSharing, setIsSharing] = useState(false);
  const trust = doc.run?.trust;
  const isKnown = (doc.run?.events ?? []).length > 0; // of a clip in which nothing happens, nothing is sure
  const level = isKnown && (TRUST_LEVELS[trust?.level] ?? trust?.level);
  return html`<div class="shot-head">
    <a class="back" href=${routeTo("library")} aria-label=${text.shot.back}>‹</a>
    <h1>${doc.name}</h1>
    ${level && html`<details class="why"><summary><${TrustMark} level=${level} /></summary>
      <ul>${trust.reasons.map((reason) => html`<li key=${reason}>${reason}</li>`)}</ul></details>`}
    <button onClick=${() => setIsSharing(true)}>${text.share.open}</button>
    ${isSharing && html`<${ShareDialog} shot=${shot} onClose=${() => setIsSharing(false)} />`}
  </div>`;
}

function Tabs({ shot, tabs }) {
  const { tab } = useStore(shot.desk);
  const names = Object.keys(tabs);
  const shown = names.includes(tab) ? tab : names[0];
  const Panel = tabs[shown];
  const choose = (name) => shot.desk.set({ tab: name, bodies: [], question: null, cross: null, ball: null, event: null, spot: null });
  const move = (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    const next = names[(names.indexOf(shown) + step + names.length) % names.length];
    choose(next);
    document.getElementById(`tab-${next}`).focus();
  };
  return html`<section class="tabs" aria-label=${text.shot.details}>
    <div role="tablist" aria-label=${text.shot.details} onKeyDown=${move}>
      ${names.map((name) => html`<button key=${name} role="tab" id=${`tab-${name}`} aria-controls="tab-panel"
        aria-selected=${name === shown}
        tabindex=${name === shown ? 0 : -1} onClick=${() => choose(name)}>${text.tabs[name]}</button>`)}
    </div>
    <div role="tabpanel" id="tab-panel" aria-labelledby=${`tab-${shown}`}><${Panel} shot=${shot} /></div>
  </section>`;
}
