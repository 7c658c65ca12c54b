// The table or court from above, in step with the video: paths, balls, what-if paths, rings to put balls back.
import { html, useMemo, useRef } from "../html.js";
import { placeAt } from "../shot/frames.js";
import { CUSHIONS } from "../shot/shot_model.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

// Share of the longer side around the playing surface, for rails and pockets.
const MARGIN = 0.05;
// px of the screen within which a tap means a ball.
const TAP_PX = 24;

export function Plan({ shot }) {
  const { doc } = useStore(shot.state);
  const { bodies, played, rings, tab, event } = useStore(shot.desk);
  const { plan } = doc;
  const turned = useRef(null);
  const balls = doc.run?.balls ?? [];
  const colours = new Map(balls.map((ball) => [ball.id, ball.colour]));
  const margin = MARGIN * Math.max(plan.length, plan.width);
  const paths = useMemo(() => plan.paths.map((path, k) => [path.id, drawPath(path, Infinity), k]), [plan]);
  const onClick = (click) => {
    if (!balls.length) return;
    const matrix = turned.current.getScreenCTM();
    const place = new DOMPoint(click.clientX, click.clientY).matrixTransform(matrix.inverse());
    tapPlan(shot, [place.x, place.y], TAP_PX / Math.hypot(matrix.a, matrix.b));
  };
  const path = event && plan.paths.find((one) => one.id === event.a);
  const place = path && placeAt(path, event.t);
  const chosen = (kind, id) => bodies.some((one) => one.kind === kind && one.id === id);
  return html`<figure class="plan"><svg class=${`plan-svg ${doc.kind}`} viewBox=${turnBox(plan, margin)} role="img"
      aria-label=${text.plan.label(doc.name)} onClick=${onClick}>
    <g ref=${turned} transform=${`rotate(${90 * (plan.turns ?? 0)})`}>
      ${doc.kind === "rally" ? html`<${Court} plan=${plan} margin=${margin} landings=${doc.landings ?? []} />`
        : html`<${Table} plan=${plan} margin=${margin} chosen=${chosen} />`}
      ${paths.map(([id, d, k]) => html`<path key=${k} class="path" d=${d} stroke=${colours.get(id)} />`)}
      ${tab === "play" && played?.paths.map((one) => html`<path key=${`played ${one.id}`} class="path played"
        d=${drawPath(one, Infinity)} stroke=${colours.get(one.id)} />`)}
      ${tab === "placement" && rings?.balls.map((one) => html`<circle key=${`ring ${one.id}`} class="ring"
        cx=${one.xy[0]} cy=${one.xy[1]} r=${plan.ball_radius + 2 * one.sigma_mm / 1000} />`)}
      ${place && html`<circle class="contact-mark" cx=${place[0]} cy=${place[1]} r=${1.7 * (plan.ball_radius ?? 0.05)} />`}
      <${MovingBalls} shot=${shot} plan=${plan} balls=${balls} played=${tab === "play" ? played : null} chosen=${chosen} />
    </g>
  </svg>
  ${balls.length > 0 && html`<figcaption>${text.plan.hint(plan.pockets ?? [])}</figcaption>`}</figure>`;
}

/** The view box of a plan that is turned clockwise by quarters about its origin, so that it lies as in the frame. */
function turnBox({ length, width, turns = 0 }, margin) {
  const corners = [[-margin, -margin], [length + margin, width + margin]].map(([x, y]) => (
    [[x, y], [-y, x], [-x, -y], [y, -x]][turns % 4]));
  const [left, top] = [0, 1].map((k) => Math.min(corners[0][k], corners[1][k]));
  return [left, top, ...[0, 1].map((k) => Math.abs(corners[1][k] - corners[0][k]))].join(" ");
}

function Table({ plan, margin, chosen }) {
  const { length, width } = plan;
  const rails = { top: [0, 0, length, 0], bottom: [0, width, length, width], left: [0, 0, 0, width], right: [length, 0, length, width] };
  const spots = [1, 2, 3].map((k) => [length * k / 4, width / 2]);
  return html`<g><rect class="rail" x=${-margin} y=${-margin} width=${length + 2 * margin} height=${width + 2 * margin}
    rx=${margin * 0.8} />
    <rect class="cloth" x="0" y="0" width=${length} height=${width} />
    ${plan.baulk !== null && html`<${BaulkLine} plan=${plan} />`}
    ${spots.map(([x, y]) => html`<circle key=${x} class="dot" cx=${x} cy=${y} r=${length / 500} />`)}
    ${Object.entries(rails).map(([id, [x1, y1, x2, y2]]) => html`<line key=${id}
      class=${`nose ${chosen("rail", id) ? "chosen" : ""}`} data-rail=${id}
      x1=${x1} y1=${y1} x2=${x2} y2=${y2} />`)}
    ${plan.pockets.map((one) => html`<circle key=${one.name} class=${`pocket ${chosen("pocket", one.name) ? "chosen" : ""}`}
      data-pocket=${one.name}
      cx=${one.x} cy=${one.y} r=${one.radius} />`)}</g>`;
}

/** The baulk line, with the D on the side of the nearer short rail. */
function BaulkLine({ plan: { baulk, d_radius: r, length, width } }) {
  const middle = width / 2;
  return html`<path class="baulk" d=${`M${baulk} 0V${width}M${baulk} ${middle - r}A${r} ${r} 0 0 ${baulk < length / 2 ? 0 : 1} ${baulk} ${middle + r}`} />`;
}

function Court({ plan, margin, landings }) {
  return html`<g><rect class="court-around" x=${-margin} y=${-margin} width=${plan.length + 2 * margin}
    height=${plan.width + 2 * margin} />
    <rect class="court" x="0" y="0" width=${plan.length} height=${plan.width} />
    ${plan.lines.map(([x1, y1, x2, y2], k) => html`<line key=${k}
      class="court-line" x1=${x1} y1=${y1} x2=${x2} y2=${y2} />`)}
    ${plan.net && html`<line class="net" x1=${plan.net[0]} y1=${plan.net[1]} x2=${plan.net[2]} y2=${plan.net[3]} />`}
    ${landings.map((one, k) => html`<${Landing} key=${k} one=${one} />`)}</g>`;
}

/** The ellipse of two standard deviations of a landing. */
function Landing({ one }) {
  const { sxx, sxy, syy } = one;
  const half = (sxx + syy) / 2;
  const root = Math.hypot((sxx - syy) / 2, sxy);
  const turn = Math.atan2(2 * sxy, sxx - syy) / 2 * 180 / Math.PI;
  return html`<g class=${`landing ${one.verdict}`}><title>${one.text}</title>
    <ellipse rx=${2 * Math.sqrt(half + root)} ry=${2 * Math.sqrt(Math.max(half - root, 0))}
      transform=${`translate(${one.x} ${one.y}) rotate(${turn})`} />
    <circle cx=${one.x} cy=${one.y} r="0.05" /></g>`;
}

function MovingBalls({ shot, plan, balls, played, chosen }) {
  const { t } = useStore(shot.player.clock);
  const looks = new Map(balls.map((ball) => [ball.id, ball]));
  const draw = (path, name, k) => {
    const place = placeAt(path, t);
    const colour = looks.get(path.id)?.colour ?? "#fff";
    return place && html`<g key=${`${name} ${k}`}>
      ${name === "real" && html`<path class="path past" d=${drawPath(path, t)} stroke=${colour} />`}
      <circle class=${`plan-ball ${name} ${name === "real" && chosen("ball", path.id) ? "chosen" : ""}`} cx=${place[0]}
        cy=${place[1]}
        r=${(plan.ball_radius ?? 0.06) * 1.15} fill=${colour} data-plan-ball=${path.id}>
          <title>${looks.get(path.id)?.name ?? ""}</title></circle></g>`;
  };
  return html`<g>${plan.paths.map((path, k) => draw(path, "real", k))}${played?.paths.map((path, k) => draw(path, "ghost", k))}</g>`;
}

/** Path data of a ball until a time; a gap where it is not on the table. */
function drawPath({ t, x, y }, until) {
  let d = "";
  let isDown = false;
  for (let k = 0; k < t.length && t[k] <= until; k += 1) {
    const isThere = x[k] !== null && y[k] !== null;
    if (isThere) d += `${isDown ? "L" : "M"}${x[k]} ${y[k]}`;
    isDown = isThere;
  }
  return d;
}

function tapPlan(shot, [x, y], reach) {
  const { plan, run } = shot.doc;
  const { t } = shot.player.clock.get();
  const names = new Map(run.balls.map((ball) => [ball.id, ball.name]));
  const nearest = (list) => list.filter(([distance]) => distance < reach).sort((one, two) => one[0] - two[0])[0]?.[1];
  const ball = nearest(plan.paths.map((path) => [path, placeAt(path, t)]).filter(([, place]) => place)
    .map(([path, place]) => [Math.hypot(place[0] - x, place[1] - y), { kind: "ball", id: path.id, name: names.get(path.id) ?? path.id }]));
  const pocket = nearest(plan.pockets.map((one) => [Math.hypot(one.x - x, one.y - y), { kind: "pocket", id: one.name, name: one.label }]));
  const distances = { left: Math.abs(x), right: Math.abs(plan.length - x), top: Math.abs(y), bottom: Math.abs(plan.width - y) };
  const rail = nearest(CUSHIONS.map((id) => [distances[id], { kind: "rail", id, name: run.rails[id] ?? id }]));
  const body = ball ?? pocket ?? rail;
  if (body) shot.tap(body);
  else shot.desk.set({ bodies: [] });
}
