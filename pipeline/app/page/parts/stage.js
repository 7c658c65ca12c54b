// The picture of a shot: its slow motion or its frames, with what can be tapped on top.
import { html, useEffect, useRef, useState } from "../html.js";
import { fileAddress } from "../api.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";
import { Lens } from "./lens.js";
import { StageOverlay } from "./stage_overlay.js";

// Frames that are loaded ahead.
const AHEAD = 3;

const ZOOMS = [1, 1.5, 2, 3, 4, 5];

/** Which picture is shown, or in corrections how large. */
export function PictureSwitch({ shot }) {
  const { doc } = useStore(shot.state);
  const { tab, zoom } = useStore(shot.desk);
  const showsFrames = useStore(shot.desk, () => shot.showsFrames);
  if (tab === "correct") {
    return html`<label class="zoom">${text.stage.zoom}<input id="zoom" type="range" min="0" max=${ZOOMS.length - 1} step="1"
      value=${ZOOMS.indexOf(zoom)} aria-valuetext=${text.stage.times(zoom)}
      onInput=${(event) => shot.desk.set({ zoom: ZOOMS[event.target.value] })} /></label>`;
  }
  if (!doc.video || doc.clip === false) return null;
  return html`<div class="switch" role="group" aria-label=${text.stage.picture}>
    ${["slow", "frames"].map((one) => html`<button key=${one} aria-pressed=${(one === "frames") === showsFrames}
      onClick=${() => shot.desk.set({ picture: one })}>${text.stage.pictures[one]}</button>`)}</div>`;
}

export function Stage({ shot }) {
  const { doc } = useStore(shot.state);
  const { question, zoom, tab } = useStore(shot.desk);
  const box = useRef(null);
  const showsFrames = useStore(shot.desk, () => shot.showsFrames);
  const [width, height] = doc.run?.image ?? [16, 9];
  const room = `calc((100vh - 15rem) * ${width / height})`;
  return html`<div class="stage-box ${question ? "asks" : ""}">
    <div class="scroller" ref=${box} tabindex="0" role="group" aria-label=${text.stage.label} style=${{ "--room": room }}>
      <div class="stage" style=${{ width: `${100 * zoom}%`, aspectRatio: `${width} / ${height}` }}>
        ${showsFrames ? html`<${FrameImage} shot=${shot} />` : doc.video ? html`<${SlowVideo} shot=${shot}
          key=${doc.video.file} />`
          : html`<p class="no-thumb">${text.stage.noPicture}</p>`}
        ${doc.run && html`<${StageOverlay} shot=${shot} showsFrames=${showsFrames} />`}
        ${question?.point || tab === "correct" ? html`<${ShotLens} shot=${shot} />` : null}
      </div>
    </div>
  </div>`;
}

function ShotLens({ shot }) {
  const { cross, dragged } = useStore(shot.desk);
  return html`<${Lens} at=${cross ?? dragged} image="frame" />`;
}

function SlowVideo({ shot }) {
  const { doc } = useStore(shot.state);
  const video = useRef(null);
  const [isMissing, setIsMissing] = useState(false);
  useEffect(() => {
    shot.player.attach(video.current);
    return () => shot.player.attach(null);
  }, [shot, shot.player]);
  return html`<video ref=${video} src=${fileAddress(shot.id, doc.video.file)} muted playsinline preload="auto" tabindex="-1"
      aria-label=${text.stage.video} onError=${() => setIsMissing(true)}></video>
    ${isMissing && html`<p class="missing" role="alert">${text.stage.missing}</p>`}`;
}

function FrameImage({ shot }) {
  const { row } = useStore(shot.player.clock);
  const { distinct } = shot.player.frames;
  const frame = distinct[row];
  const [isShown, setIsShown] = useState(false); // frames are decoded when the first one is asked for
  useEffect(() => {
    for (let k = 1; k <= AHEAD; k += 1) if (distinct[row + k] !== undefined) new Image().src = shot.frameAddress(distinct[row + k]);
  }, [row]);
  return html`<img id="frame" src=${shot.frameAddress(frame)} alt=${text.stage.frame(frame)} draggable=${false}
      onLoad=${() => setIsShown(true)} />${!isShown && html`<p class="missing" role="status">${text.stage.loading}</p>`}`;
}
