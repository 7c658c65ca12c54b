// What lies over the picture of a shot: balls, the corners of the table, contacts, rings; and what a tap on it means.
import { html, useLayoutEffect, useRef, useState } from "../html.js";
import { distanceToSegment, pixelAt, projectTable } from "../shot/frames.js";
import {
  cancelCorrection, finishDrag, moveCorner, pickBall, pickCushion, placeBall, showsCorners, shownCorners,
} from "../shot/hand_tools.js";
import { CUSHIONS } from "../shot/shot_model.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

// px of the screen within which a tap means a thing.
const TAP_PX = 24;
const TRAIL_FRAMES = 40;
// Corners at the ends of each rail.
const SIDES = { top: [0, 1], right: [1, 2], bottom: [2, 3], left: [3, 0] };

export function StageOverlay({ shot, showsFrames }) {
  const { doc } = useStore(shot.state);
  const desk = useStore(shot.desk);
  const { t, row } = useStore(shot.player.clock);
  const svg = useRef(null);
  const drag = useRef(null);
  const [scale, setScale] = useState(1);
  const run = doc.run;
  const [width, height] = run.image;
  useLayoutEffect(() => {
    const measure = () => setScale(width / Math.max(svg.current.clientWidth, 1)); // px of the frame per px of the screen
    const observer = new ResizeObserver(measure);
    observer.observe(svg.current);
    return () => observer.disconnect();
  }, [width]);
  const { frames } = shot.player;
  const at = showsFrames ? frames.distinct[row] : frames.first + fractionalIndex(frames, t);
  const isCorrecting = desk.tab === "correct";
  const corners = isCorrecting && showsCorners(shot) ? shownCorners(shot) : [];
  const balls = run.balls.map((ball) => ({ ball, place: pixelAt(ball.path, at), point: ball.path.find((one) => one[0] === Math.round(at)) }))
    .filter(({ place, point }) => (isCorrecting ? point : place));
  const chosen = isCorrecting ? [desk.ball] : desk.bodies.map((one) => one.id);

  const pixel = (event) => {
    const box = svg.current.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width * width - 0.5, (event.clientY - box.top) / box.height * height - 0.5];
  };
  const onDown = (event) => {
    const corner = event.target.dataset.corner;
    if (event.button || !isCorrecting) return;
    if (desk.question?.point) {
      drag.current = { point: true };
      shot.desk.set({ cross: pixel(event) });
    } else if (corner !== undefined && !desk.question) drag.current = { corner: Number(corner), last: pixel(event), moved: false };
    else return;
    event.preventDefault();
    svg.current.setPointerCapture(event.pointerId);
  };
  const onMove = (event) => {
    const place = isCorrecting && pixel(event);
    if (drag.current?.corner !== undefined) {
      moveCorner(shot, drag.current.corner, place[0] - drag.current.last[0], place[1] - drag.current.last[1]);
      drag.current = { ...drag.current, last: place, moved: true };
    } else if (isCorrecting && desk.question?.point && (drag.current || event.pointerType === "mouse")) shot.desk.set({ cross: place });
  };
  const onUp = () => {
    if (drag.current?.moved) finishDrag(shot);
    else if (drag.current?.point) placeBall(shot);
    drag.current = drag.current?.moved ? { done: true } : null;
  };
  const onClick = (event) => {
    if (drag.current?.done || event.target.dataset.corner !== undefined || isCorrecting && desk.question?.point) {
      drag.current = null;
      return;
    }
    const place = pixel(event);
    const reach = TAP_PX * scale;
    const near = balls.map(({ ball, place: [x, y] }) => [Math.hypot(x - place[0], y - place[1]), ball])
      .filter(([distance, ball]) => distance < Math.max(1.3 * ball.radius, reach)).sort((one, two) => one[0] - two[0])[0];
    if (shot.isRally && !isCorrecting) return;
    if (isCorrecting) {
      if (near) pickBall(shot, near[1].id);
      else if (event.target.dataset.cushion) pickCushion(shot, event.target.dataset.cushion);
      else if (!desk.question) cancelCorrection(shot);
    } else if (near) shot.tap({ kind: "ball", id: near[1].id, name: near[1].name });
    else tapTable(shot, place, reach);
  };
  const labelled = isCorrecting || showsFrames;
  return html`<svg id="overlay" ref=${svg} class=${`overlay ${desk.question ? "asks" : ""}`}
    viewBox=${`-0.5 -0.5 ${width} ${height}`}
      aria-label=${text.stage.overlay} role="group" onPointerDown=${onDown} onPointerMove=${onMove} onPointerUp=${onUp}
      onPointerCancel=${() => { drag.current = null; shot.desk.set({ cross: null, corners: null, dragged: null }); }} onClick=${onClick}>
    ${corners.length > 0 && html`<polygon class="table-line" points=${corners.map((one) => one.join(",")).join(" ")} />`}
    ${isCorrecting && desk.question?.cushions && corners.length > 0 && Object.entries(SIDES).map(([side, [a, b]]) => html`<line key=${side} class="cushion"
      x1=${corners[a][0]} y1=${corners[a][1]} x2=${corners[b][0]} y2=${corners[b][1]} data-cushion=${side}>
        <title>${run.rails[side]}</title></line>`)}
    ${showsFrames && run.balls.map((ball) => html`<polyline key=${ball.id} class="trail" stroke=${ball.colour}
      points=${trail(ball, at)} />`)}
    ${balls.map(({ ball, place: [x, y], point }) => {
      const isChosen = chosen.includes(ball.id);
      return html`<g key=${ball.id}>
        ${(showsFrames || isChosen) && html`<circle class="halo" cx=${x} cy=${y} r=${ball.radius + 2.5 * scale} />`}
        <circle class=${`ball ${point && !point[3] ? "filled-in" : ""} ${isChosen ? "chosen" : ""} ${showsFrames || isChosen ? "" : "unseen"}`}
          cx=${x} cy=${y} r=${ball.radius} stroke=${ball.colour} data-ball=${ball.id}>
            <title>${point && !point[3] ? text.stage.filledIn(ball.name) : ball.name}</title></circle>
        ${labelled && !shot.isRally && html`<text class="name" x=${x} y=${y - ball.radius - 6 * scale} font-size=${12 * scale}>${ball.name}
          </text>`}
      </g>`;
    })}
    ${showsFrames && run.events.filter((one) => one.px && Math.abs(one.frame - at) <= 1.5).map((one, k) => html`<circle
      key=${k} class="contact"
      cx=${one.px[0]} cy=${one.px[1]} r=${16 * scale} />`)}
    ${desk.spot && html`<circle class="halo spot" cx=${desk.spot[0]} cy=${desk.spot[1]} r=${26 * scale} />`}
    ${desk.tab === "placement" && (desk.rings?.balls ?? []).filter((one) => one.px).map((one) => html`<g
      key=${`ring ${one.id}`}>
      <circle class="ring" cx=${one.px[0]} cy=${one.px[1]} r=${one.radius_px} /><circle class="ring-dot" cx=${one.px[0]}
        cy=${one.px[1]} r=${2 * scale} /></g>`)}
    ${corners.map(([x, y], k) => html`<g key=${`corner ${k}`}>
      <circle class="corner" cx=${x} cy=${y} r=${12 * scale} tabindex="0" role="button" data-corner=${k}
        aria-label=${text.stage.corner(k, x, y)} />
      <path class="corner-cross" d=${`M${x - 6 * scale} ${y}h${12 * scale}M${x} ${y - 6 * scale}v${12 * scale}`} /></g>`)}
    ${desk.cross && html`<path class="crosshair"
      d=${`M${desk.cross[0] - 14 * scale} ${desk.cross[1]}h${28 * scale}M${desk.cross[0]} ${desk.cross[1] - 14 * scale}v${28 * scale}`} />`}
  </svg>`;
}

function fractionalIndex({ t: times }, t) {
  let k = 0;
  while (k + 1 < times.length && times[k + 1] <= t) k += 1;
  const next = times[k + 1];
  return next === undefined ? k : k + Math.max(0, Math.min(1, (t - times[k]) / (next - times[k] || 1)));
}

const trail = (ball, at) => ball.path.filter(([frame]) => frame <= at && frame > at - TRAIL_FRAMES)
  .map(([, x, y]) => `${x},${y}`).join(" ");

/** A tap beside every ball means the nearest pocket or rail within reach. */
function tapTable(shot, place, reach) {
  const { corners, rails } = shot.run;
  const { plan } = shot.doc;
  const pockets = (plan?.pockets ?? []).map((pocket) => {
    const [x, y] = projectTable(corners, pocket.x / plan.length, pocket.y / plan.width);
    return [Math.hypot(x - place[0], y - place[1]), { kind: "pocket", id: pocket.name, name: pocket.label }];
  });
  const sides = CUSHIONS.map((id) => [
    distanceToSegment(place, ...SIDES[id].map((k) => corners[k])), { kind: "rail", id, name: rails[id] },
  ]);
  const nearest = (list) => list.sort((one, two) => one[0] - two[0])[0];
  for (const [distance, body] of [nearest(pockets), nearest(sides)].filter(Boolean)) {
    if (distance < 1.6 * reach) { shot.tap(body); return; }
  }
  shot.desk.set({ bodies: [] });
}
