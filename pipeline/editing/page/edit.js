// The page of `trueroll edit`: it shows a run and turns clicks, touches and keys into corrections.
const $ = (id) => document.getElementById(id);
const element = (name, properties = {}) => Object.assign(document.createElement(name), properties);
const SVG = "http://www.w3.org/2000/svg";
const POLL_MS = 400;
const PLAY_MS = 90;
const LENS_ZOOM = 4;
const LENS_PX = 168;
const CUSHIONS = ["left", "right", "top", "bottom"];
const CORNER_NAMES = ["top left", "top right", "bottom right", "bottom left"];
const SIDES = { top: [0, 1], right: [1, 2], bottom: [2, 3], left: [3, 0] };
const TRAIL_FRAMES = 40;
const NEAR_FRAMES = 2.5;
const RATES = ["23.976", "24", "25", "29.97", "30", "50", "59.94", "60", "100", "120", "240"];

const page = {
  state: null, row: 0, ball: null, event: null, ask: null, check: -1, place: null, timer: null,
  corners: null, cross: null, paths: new Map(), keys: [], busy: false,
};

// ---------------------------------------------------------------- talking to the server

async function send(method, path, body) {
  const headers = { "If-Match": `"${page.state.revision}"` };
  if (body) headers["Content-Type"] = "application/json";
  const answer = await fetch(path, { method, headers, body: body && JSON.stringify(body) });
  const content = await answer.json();
  if (!answer.ok) {
    if (answer.status === 412) await load();
    showMessage(content.error);
    return null;
  }
  return content;
}

async function change(edit) {
  if (page.busy || !page.state) return false;
  page.busy = true;
  try {
    const next = structuredClone(page.state.corrections);
    edit(next);
    for (const name of ["balls", "tracks", "contacts"]) if (next[name] && !next[name].length) delete next[name];
    const status = await send("PUT", "corrections", next);
    if (status) {
      hideMessage(); // it was about the corrections before
      page.state.corrections = next;
      page.state.revision = status.revision;
      showStatus(status);
    }
    return Boolean(status);
  } catch {
    showMessage("The editor does not answer; is trueroll edit still running?");
    return false;
  } finally {
    page.busy = false;
  }
}

async function act(path) {
  if (page.busy || !page.state) return;
  const status = await send("POST", path);
  if (status && status.revision !== page.state.revision) await load();
}

async function load() {
  const answer = await fetch("state");
  const before = page.state;
  page.state = await answer.json();
  page.corners = null;
  render(before?.run == null && page.state.run != null);
  if (page.state.notice && page.state.notice !== before?.notice) showMessage(page.state.notice);
}

async function poll() {
  try {
    const status = await (await fetch("status")).json();
    showStatus(status);
    if (!page.state || (!page.busy && (status.revision !== page.state.revision || status.result !== page.state.result))) {
      await load();
    }
  } catch {
    $("progress-text").textContent = "The editor does not answer; is trueroll edit still running?";
  }
  setTimeout(poll, POLL_MS);
}

function showStatus(status) {
  const words = { read: "Reading the clip", calibrate: "Locating the table", detect: "Detecting balls",
    place: "Measuring placed balls", track: "Tracking balls", motion: "Fitting the motion", fit: "Fitting the whole shot", poster: "Drawing the poster",
    page: "Writing the report", export: "Writing the tables",
    render: "Rendering the slow motion", record: "Writing the recording", report: "Writing the report",
    forecast: "Forecasting" };
  const outputs = { current: "Events, video and report are up to date", older: "Events are up to date; video and report are older",
    missing: "Events are up to date; there is no report yet" };
  const runs = status.stage || status.result !== status.revision && !status.error;
  $("progress-text").textContent = status.stage ? `${words[status.stage] ?? status.stage} …`
    : runs ? "Starting …" : status.error ? "The run failed" : outputs[status.outputs];
  const bar = $("progress");
  if (runs && !status.share) bar.removeAttribute("value");
  else bar.value = runs ? status.share : 1;
  $("undo").disabled = !status.can_undo;
  $("redo").disabled = !status.can_redo;
  $("finish").disabled = Boolean(runs);
  if (status.error && status.error !== page.lastError) showMessage(status.error);
  else if (page.lastError && !status.error) hideMessage();
  page.lastError = status.error;
}

const hideMessage = () => { $("message").hidden = true; };

function showMessage(sentence) {
  $("message").hidden = false;
  $("message").firstElementChild.textContent = sentence;
}

// ---------------------------------------------------------------- frames and places

const run = () => page.state?.run;
const isUpToDate = () => page.state.result === page.state.revision;
const frames = () => run()?.frames.distinct ?? [];
const frame = () => frames()[page.row] ?? 0;

function rowOf(number) {
  const all = frames();
  let best = 0;
  for (let k = 0; k < all.length; k++) if (Math.abs(all[k] - number) < Math.abs(all[best] - number)) best = k;
  return best;
}

function show(row) {
  if (!run()) return;
  page.row = Math.max(0, Math.min(frames().length - 1, row));
  $("slider").value = page.row;
  const image = `frame/${frame()}`;
  if (!$("frame").src.endsWith(image)) $("frame").src = image;
  for (const ahead of [1, 2, 3]) if (frames()[page.row + ahead] !== undefined) new Image().src = `frame/${frames()[page.row + ahead]}`;
  const seconds = run().frames.t[frame() - run().frames.first] ?? 0;
  $("when").textContent = `frame ${frame()}, ${seconds.toFixed(3)} s`;
  $("slider").setAttribute("aria-valuetext", $("when").textContent);
  draw();
}

function pointOf(id, number) { // the point of a ball in a frame, or in the nearest frame that has one
  const path = page.paths.get(id) ?? [];
  let best = null;
  for (const point of path) if (!best || Math.abs(point[0] - number) < Math.abs(best[0] - number)) best = point;
  return best;
}

const pointHere = (id) => page.paths.get(id).find((point) => point[0] === frame());

function placeOf(id, number = frame()) { // how corrections name a ball
  const point = pointOf(id, number);
  return point && { frame: point[0], x_px: point[1], y_px: point[2], id };
}

const placeOfPoint = ([number, x, y]) => ({ frame: number, x_px: x, y_px: y });

function keepKeys() { // a number key stays with its ball, whatever the ball is called
  const kept = new Map();
  for (const [key, place] of page.keys) {
    const id = nameAt(place);
    if (id && !kept.has(id)) kept.set(id, key);
  }
  const used = [...kept.values()];
  for (const { id } of run().balls) {
    if (kept.has(id)) continue;
    for (let key = 1; !kept.has(id); key++) if (!used.includes(key)) { kept.set(id, key); used.push(key); }
  }
  page.keys = run().balls.filter((ball) => ball.path.length).map((ball) => [kept.get(ball.id), placeOfPoint(ball.path[0]), ball.id]);
}

const keyOf = (id) => page.keys.find((one) => one[2] === id)?.[0] ?? "";
const callBall = (id) => run().balls.find((ball) => ball.id === id)?.name ?? id;
const callRail = (side) => run().rails[side] ?? side;
const imageScale = () => run().image[0] / Math.max($("overlay").clientWidth, 1); // px of the frame per px of the screen
const showsCorners = () => !run().moves || page.row === 0; // of a moving camera they belong to its first frame
const corners = () => page.corners ?? (isUpToDate() ? run().corners : page.state.corrections.corners ?? run().corners);
const add = (list, name, entry) => { list[name] = [...(list[name] ?? []), entry]; };

// ---------------------------------------------------------------- drawing

function make(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent.append(made);
  return made;
}

function draw() {
  const svg = $("overlay");
  const focused = document.activeElement?.dataset?.corner;
  svg.replaceChildren();
  if (!run()) return;
  const [width, height] = run().image;
  const scale = imageScale();
  svg.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  const points = showsCorners() ? corners() : [];
  if (points.length) make("polygon", { class: "table-line", points: points.map((p) => p.join(",")).join(" ") }, svg);
  if (page.ask?.cushions && points.length) {
    for (const [side, [a, b]] of Object.entries(SIDES)) {
      const line = make("line", { class: "cushion", x1: points[a][0], y1: points[a][1], x2: points[b][0], y2: points[b][1],
        "data-cushion": side }, svg);
      make("title", {}, line).textContent = callRail(side);
    }
  }
  for (const ball of run().balls) {
    const path = page.paths.get(ball.id).filter((p) => p[0] <= frame() && p[0] > frame() - TRAIL_FRAMES);
    if (path.length > 1) make("polyline", { class: "trail", stroke: ball.colour, points: path.map((p) => `${p[1]},${p[2]}`).join(" ") }, svg);
  }
  for (const ball of run().balls) {
    const point = pointHere(ball.id);
    if (!point) continue;
    const at = { cx: point[1], cy: point[2] };
    make("circle", { class: "halo", ...at, r: ball.radius + 2.5 * scale }, svg);
    const ring = make("circle", { class: `ball${point[3] ? "" : " filled-in"}${page.ball === ball.id ? " chosen" : ""}`, ...at,
      r: ball.radius, stroke: ball.colour, "data-ball": ball.id }, svg);
    make("title", {}, ring).textContent = point[3] ? ball.name : `${ball.name} (not detected here: filled in by the physics)`;
    if ($("labels").checked) {
      make("text", { class: "name", x: point[1], y: point[2] - ball.radius - 5 * scale, "font-size": 12 * scale }, svg).textContent = ball.name;
    }
  }
  for (const event of run().events) {
    if (event.px && Math.abs(event.frame - frame()) <= 1.5) {
      make("circle", { class: "contact", cx: event.px[0], cy: event.px[1], r: 16 * scale }, svg);
    }
  }
  if (page.place) make("circle", { class: "halo place", cx: page.place[0], cy: page.place[1], r: 26 * scale }, svg);
  points.forEach(([x, y], k) => {
    const handle = make("circle", { class: "corner", cx: x, cy: y, r: 11 * scale, tabindex: 0, role: "button", "data-corner": k,
      "aria-label": `${CORNER_NAMES[k]} corner of the table at ${x.toFixed(1)}, ${y.toFixed(1)} px; drag it or use the arrow keys` }, svg);
    for (const [dx, dy] of [[1, 0], [0, 1]]) {
      make("line", { class: "corner-cross", x1: x - 6 * dx * scale, x2: x + 6 * dx * scale, y1: y - 6 * dy * scale, y2: y + 6 * dy * scale }, svg);
    }
    if (focused === String(k)) handle.focus({ preventScroll: true });
  });
  if (page.cross) {
    const [x, y] = page.cross;
    make("line", { class: "crosshair", x1: x - 14 * scale, x2: x + 14 * scale, y1: y, y2: y }, svg);
    make("line", { class: "crosshair", x1: x, x2: x, y1: y - 14 * scale, y2: y + 14 * scale }, svg);
  }
}

function fitStage() { // the whole frame fits into its place, times the zoom
  if (!run()) return;
  const [width, height] = run().image;
  const room = Math.min($("scroller").clientWidth, (innerHeight - 290) * width / height);
  const fits = innerWidth > 900 ? Math.max(room, 320) : $("scroller").clientWidth;
  $("stage").style.width = `${Math.round(fits * $("zoom").value)}px`;
  draw();
}

function magnify(at) {
  const lens = $("lens");
  lens.hidden = !at;
  if (!at) return;
  const [x, y] = at;
  const image = $("frame");
  const context = lens.getContext("2d");
  const size = LENS_PX / LENS_ZOOM * image.naturalWidth / Math.max(image.clientWidth, 1);
  context.imageSmoothingEnabled = true;
  context.fillStyle = "#101512";
  context.fillRect(0, 0, LENS_PX, LENS_PX);
  context.drawImage(image, x + 0.5 - size / 2, y + 0.5 - size / 2, size, size, 0, 0, LENS_PX, LENS_PX);
  context.strokeStyle = "#ffd666";
  context.lineWidth = 1.5;
  context.beginPath();
  for (const [a, b] of [[[0, 0.5], [0.44, 0.5]], [[0.56, 0.5], [1, 0.5]], [[0.5, 0], [0.5, 0.44]], [[0.5, 0.56], [0.5, 1]]]) {
    context.moveTo(a[0] * LENS_PX, a[1] * LENS_PX);
    context.lineTo(b[0] * LENS_PX, b[1] * LENS_PX);
  }
  context.stroke();
  const shown = image.clientWidth / image.naturalWidth;
  const left = x * shown + (x * shown < image.clientWidth / 2 ? 30 : -LENS_PX - 30);
  const top = Math.max(0, Math.min(image.clientHeight - LENS_PX, y * shown - LENS_PX / 2));
  lens.style.left = `${left}px`;
  lens.style.top = `${top}px`;
}

// ---------------------------------------------------------------- lists

function fill(list, rows, empty) {
  list.replaceChildren(...rows);
  if (!rows.length) list.append(element("li", { className: "small", textContent: empty }));
}

function entry(parts, pick, chosen) {
  const line = element("li");
  const button = element("button", { className: "item" });
  for (const [className, text] of parts) button.append(element("span", { className, textContent: text }));
  button.setAttribute("aria-pressed", String(Boolean(chosen)));
  button.addEventListener("click", pick);
  line.append(button);
  return line;
}

function render(isFirst) {
  const state = page.state;
  $("name").textContent = state.name;
  if (!state.run) return;
  const shown = state.run;
  document.title = `Correct ${state.name} · trueroll`;
  const chosen = page.paths.get(page.ball)?.[0];
  page.paths = new Map(shown.balls.map((ball) => [ball.id, ball.path]));
  if (page.ball && !page.paths.has(page.ball)) page.ball = (chosen && nameAt(placeOfPoint(chosen))) ?? null;
  keepKeys();
  if (page.event) page.event = shown.events.find((one) => isSameEvent(one, page.event)) ?? null;
  $("trust-dot").className = `dot ${shown.trust.level}`;
  $("trust-text").textContent = `trust ${shown.trust.level}`;
  fill($("reasons"), shown.trust.reasons.map((text) => element("li", { textContent: text })), "There is no reason.");
  $("slider").max = frames().length - 1;
  const span = Math.max(frames().at(-1) - frames()[0], 1);
  $("ticks").replaceChildren(...shown.events.filter((one) => one.kind !== "rest").map((one) => {
    const tick = element("i", { className: one.probability < 0.9 ? "unsure" : "" });
    tick.style.left = `${100 * (one.frame - frames()[0]) / span}%`;
    return tick;
  }));
  fill($("changes"), [
    ...shown.contradictions.map(listContradiction),
    ...shown.changes.map((one) => element("li", { className: one.kind, textContent: one.text })),
  ], state.revision ? "The events and calls are the same as before." : "Nothing yet: correct something in the clip.");
  fill($("checks"), shown.checks.map((one, k) => entry([["when", `${one.t.toFixed(3)} s`], ["", one.reason]],
    () => goToCheck(k), page.check === k)), "There is no doubtful place.");
  fill($("events"), shown.events.map((one) => entry([
    ["when", one.when], ["", one.text],
    handMark(one) ? ["hand", "by hand"] : [one.probability < 0.9 ? "share unsure" : "share", one.share],
  ], () => chooseEvent(one), page.event && isSameEvent(one, page.event))), "Nothing moves in this clip.");
  fill($("balls"), shown.balls.map((ball) => {
    const line = entry([["swatch", ""], ["", ball.name], ["when", `${ball.id} · ${keyOf(ball.id)}`]],
      () => pickBall(ball.id), page.ball === ball.id);
    line.querySelector(".swatch").style.background = ball.colour;
    return line;
  }), "No ball is tracked.");
  $("calls").replaceChildren(...Object.entries(shown.calls).flatMap(([question, answer]) => [
    element("dt", { textContent: question }),
    element("dd", { textContent: answer })]));
  renderSettings();
  renderByHand();
  if (isFirst) fitStage();
  show(page.row);
  renderSelection();
  if (!page.ask) hint("");
}

function listContradiction({ text, contact }) {
  const line = element("li", { className: "against" });
  line.append(element("span", { textContent: `${text} ` }));
  const mark = page.state.corrections.contacts?.[contact];
  if (isUpToDate() && mark) line.append(makeButton("Remove", `Remove the correction: ${text}`, () => change((c) => dropContact(c, mark))));
  return line;
}

const isSameEvent = (one, two) => one.kind === two.kind && one.a === two.a && one.b === two.b && Math.abs(one.frame - two.frame) < NEAR_FRAMES;

function handMark(event) { // the mark that stands for an event
  return (page.state.corrections.contacts ?? []).find((mark) => mark.kind !== "delete" && mark.cause === event.kind
    && Math.abs((mark.to_frame ?? mark.frame) - event.frame) < NEAR_FRAMES
    && [event.a, event.b].includes(nameAt(mark.ball)) && (mark.cushion ?? event.b) === event.b);
}

function nameAt(place) { // the ball that is now at a place
  let best = null;
  for (const ball of run().balls) {
    const point = pointOf(ball.id, place.frame);
    const distance = point && Math.hypot(point[1] - place.x_px, point[2] - place.y_px) / ball.radius;
    if (point && distance < 2 && (!best || distance < best[0])) best = [distance, ball.id];
  }
  return best?.[1];
}

function choose(select, values, value) {
  if (select === document.activeElement) return;
  select.replaceChildren(...values.map(([key, text]) => element("option", { value: key, textContent: text })));
  select.value = value;
}

function renderSettings() {
  const set = page.state.corrections;
  const shown = run();
  const size = `${shown.table.length} x ${shown.table.width} m`;
  const tables = page.state.tables.map((name) => [name, name]);
  if (set.table && !page.state.tables.includes(set.table)) tables.unshift([set.table, set.table]);
  choose($("table"), [["", set.table ? "recognised by the program" : `${shown.table.name}, ${size}`], ...tables], set.table ?? "");
  const rates = set.fps && !RATES.includes(set.fps) ? [set.fps, ...RATES] : RATES;
  choose($("fps"), [["", set.fps ? "as the file says" : `${shown.fps}, as the file says`], ...rates.map((rate) => [rate, rate])], set.fps ?? "");
  if ($("radius") !== document.activeElement) $("radius").value = (2000 * shown.ball_radius).toFixed(2);
  $("find-table").disabled = !set.corners;
}

function renderByHand() {
  const set = page.state.corrections;
  const rows = [];
  const names = page.state.set_by_hand;
  const keys = ["corners", "table", "ball_radius", "fps"].filter((key) => set[key] !== undefined).map((key) => [key, null]);
  for (const list of ["balls", "tracks", "contacts"]) (set[list] ?? []).forEach((_, k) => keys.push([list, k]));
  keys.forEach(([key, k], number) => {
    const line = element("li");
    line.append(element("span", { textContent: names[number] ?? key }));
    const buttons = element("span", { className: "buttons" });
    if (key === "tracks" && set.tracks[k].kind === "swap") {
      buttons.append(makeButton("Until here", `End the exchange at frame ${frame()}`, () => change((c) => { c.tracks[k].last = frame(); })));
    }
    buttons.append(makeButton("Remove", `Remove: ${names[number] ?? key}`, () => change((c) => {
      if (k === null) delete c[key];
      else c[key].splice(k, 1);
    })));
    line.append(buttons);
    rows.push(line);
  });
  fill($("by-hand"), rows, "Nothing is set by hand.");
}

function makeButton(text, label, pick, className = "") {
  const button = element("button", { textContent: text, className });
  if (label) button.setAttribute("aria-label", label);
  button.addEventListener("click", pick);
  return button;
}

// ---------------------------------------------------------------- selections and questions

function hint(text) {
  $("hint").classList.toggle("asks", Boolean(page.ask));
  $("overlay").classList.toggle("asks", Boolean(page.ask));
  $("cancel").hidden = !page.ask;
  $("hint-text").textContent = text || "Click a ball, an event or a corner to correct it.";
}

function ask(question) {
  page.ask = question;
  hint(question.text);
  draw();
  renderSelection();
}

function cancel() {
  const had = page.ask;
  page.ask = page.cross = null;
  magnify(null);
  if (!had) page.ball = page.event = page.place = null;
  hint("");
  render(false);
}

function pickBall(id) {
  const question = page.ask;
  if (question?.balls && id !== page.ball) {
    page.ask = null;
    question.done({ ball: id });
  } else if (!question) {
    page.ball = id;
    page.event = null;
    render(false);
  }
}

function pickCushion(side) {
  const question = page.ask;
  if (!question?.cushions) return;
  page.ask = null;
  question.done({ cushion: side });
}

function chooseEvent(event) {
  page.event = event;
  page.ball = null;
  page.ask = null;
  show(rowOf(Math.round(event.frame)));
  render(false);
}

function goToCheck(k) {
  const checks = run()?.checks ?? [];
  if (!checks.length) return;
  page.check = (k + checks.length) % checks.length;
  const place = checks[page.check];
  page.place = place.px;
  page.event = run().events.find((one) => Math.abs(one.frame - place.frame) < NEAR_FRAMES && place.balls.includes(one.a)) ?? null;
  page.ball = page.event ? null : place.balls.find((id) => page.paths.has(id)) ?? null;
  page.ask = null;
  show(rowOf(place.frame));
  render(false);
  hint(`Check ${page.check + 1} of ${checks.length}: ${place.reason}`);
  $("checks").querySelectorAll("button")[page.check]?.scrollIntoView({ block: "nearest" });
}

const finishQuestion = (edit) => { change(edit); hint(""); renderSelection(); draw(); };

const BALL_ACTIONS = {
  swap: { key: "x", text: "Exchange from here with …", run: (id) => ask({ balls: true, text: `Click the ball that ${callBall(id)} is exchanged with from frame ${frame()} on`,
    done: ({ ball }) => { const first = frame(); const one = placeOf(id); const two = placeOf(ball);
      finishQuestion((c) => add(c, "tracks", { kind: "swap", ball: one, other: two, first })); } }) },
  merge: { key: "m", text: "Is the same ball as …", run: (id) => ask({ balls: true, text: `Click the track that is ${callBall(id)}, too`,
    done: ({ ball }) => { const one = placeOf(id); const two = placeOf(ball);
      finishQuestion((c) => add(c, "tracks", { kind: "merge", ball: one, other: two })); } }) },
  split: { key: "s", text: "Is another ball from here", run: (id) => change((c) => add(c, "tracks", { kind: "split", ball: placeOf(id), first: frame() })) },
  contact: { key: "c", text: "Touches … here", run: (id) => ask({ balls: true, cushions: true, text: `Click the ball or cushion that ${callBall(id)} touches at frame ${frame()}`,
    done: ({ ball, cushion }) => { const at = frame(); const one = placeOf(id); const two = ball && placeOf(ball);
      finishQuestion((c) => markContact(c, ball ? { kind: "mark", cause: "ball", frame: at, ball: one, other: two }
        : { kind: "mark", cause: "cushion", frame: at, ball: one, cushion })); } }) },
  strike: { key: "k", text: "Is struck here", run: (id) => change((c) => markContact(c, { kind: "mark", cause: "strike", frame: frame(), ball: placeOf(id) })) },
  none: { key: "Delete", text: "Is no ball", danger: true, run: (id) => { page.ball = null;
    change((c) => add(c, "balls", { kind: "false", ball: placeOf(id) })); renderSelection(); } },
};

function dropContact(c, mark) {
  c.contacts = c.contacts.filter((one) => JSON.stringify(one) !== JSON.stringify(mark));
}

function isSameContact(one, two) {
  const bodies = (mark) => [nameAt(mark.ball), mark.other ? nameAt(mark.other) : mark.cushion].sort().join(" ");
  return one.cause === two.cause && Math.abs((one.to_frame ?? one.frame) - two.frame) < NEAR_FRAMES && bodies(one) === bodies(two);
}

function markContact(c, mark) { // it replaces what was set by hand for the same contact, such as its deletion
  c.contacts = (c.contacts ?? []).filter((one) => !isSameContact(one, mark));
  add(c, "contacts", mark);
}

function deleteEvent(event) {
  const byHand = handMark(event);
  page.event = null;
  renderSelection();
  change((c) => {
    if (byHand) dropContact(c, byHand);
    if (byHand?.kind !== "mark") add(c, "contacts", byHand ? { ...byHand, kind: "delete", to_frame: undefined } : describeContact("delete", event));
  });
}

function moveEvent(event, to) {
  const byHand = handMark(event);
  change((c) => {
    const same = byHand && c.contacts.find((mark) => JSON.stringify(mark) === JSON.stringify(byHand));
    if (same) same[same.kind === "move" ? "to_frame" : "frame"] = to;
    else add(c, "contacts", { ...describeContact("move", event), to_frame: to });
  });
}

function describeContact(kind, event) {
  const at = Math.round(event.frame);
  const contact = { kind, cause: event.kind, frame: Math.max(event.frame, 0), ball: placeOf(event.a, at) };
  if (event.kind === "ball") contact.other = placeOf(event.b, at);
  if (event.kind === "cushion") contact.cushion = event.b;
  return contact;
}

function renderSelection() {
  const box = $("selection");
  const focusKey = box.contains(document.activeElement) ? document.activeElement.dataset.focus : null;
  const field = box.querySelector("input:focus");
  if (field && field.value !== field.defaultValue) return; // somebody is typing
  box.replaceChildren();
  const ball = run()?.balls.find((one) => one.id === page.ball);
  box.hidden = !ball && !page.event;
  if (ball && page.ask) renderQuestion(box, ball);
  else if (ball) renderBall(box, ball);
  else if (page.event) renderEvent(box, page.event);
  if (focusKey) box.querySelector(`[data-focus="${focusKey}"]`)?.focus();
}

function renderQuestion(box, ball) {
  box.append(element("h2", { textContent: page.ask.text }));
  const row = element("div", { className: "row" });
  for (const other of run().balls) if (page.ask.balls && other.id !== ball.id) row.append(makeButton(other.name, "", () => pickBall(other.id)));
  for (const side of page.ask.cushions ? CUSHIONS : []) row.append(makeButton(callRail(side), "", () => pickCushion(side)));
  box.append(row, makeButton("Cancel", "", cancel));
}

function renderBall(box, ball) {
  box.append(element("h2", { textContent: ball.name }));
  const naming = element("form", { className: "row" });
  const label = element("label", { textContent: "Id in files", htmlFor: "ball-name" });
  const name = element("input", { id: "ball-name", defaultValue: ball.id, maxLength: 32, autocomplete: "off", spellcheck: false });
  naming.append(label, name, makeButton("Rename", "", () => {}));
  naming.addEventListener("submit", (event) => {
    event.preventDefault();
    const wanted = name.value.trim();
    name.blur();
    change((c) => {
      c.tracks = (c.tracks ?? []).filter((edit) => edit.kind !== "rename" || nameAt(edit.ball) !== ball.id);
      add(c, "tracks", { kind: "rename", ball: placeOf(ball.id), name: wanted });
    }).then((done) => { if (done) page.ball = wanted; });
  });
  const classes = element("div", { className: "row" });
  classes.setAttribute("role", "group");
  classes.setAttribute("aria-label", "Class of the ball");
  for (const kind of run().classes) {
    const button = makeButton(kind, "", () => change((c) => {
      c.tracks = (c.tracks ?? []).filter((edit) => edit.kind !== "class" || nameAt(edit.ball) !== ball.id);
      add(c, "tracks", { kind: "class", ball: placeOf(ball.id), name: kind });
    }));
    button.dataset.focus = `class-${kind}`;
    button.setAttribute("aria-pressed", String(kind === ball.kind));
    classes.append(button);
  }
  const actions = element("div", { className: "row" });
  for (const [id, action] of Object.entries(BALL_ACTIONS)) {
    const button = makeButton(`${action.text} `, "", () => action.run(ball.id), action.danger ? "danger" : "");
    button.append(element("kbd", { textContent: action.key.length > 1 ? "Del" : action.key.toUpperCase() }));
    button.dataset.action = id;
    button.dataset.focus = id;
    actions.append(button);
  }
  box.append(actions, classes, naming);
}

function renderEvent(box, event) {
  box.append(element("h2", { textContent: event.text }));
  box.append(element("p", { className: "small",
    textContent: `${event.when}, frame ${event.frame.toFixed(2)}, probability ${event.share}` }));
  if (!["strike", "ball", "cushion"].includes(event.kind)) {
    box.append(element("p", { className: "small", textContent: "It follows from the motion: correct the contacts before it." }));
    return;
  }
  const row = element("div", { className: "row" });
  const no = makeButton("Did not happen ", "", () => deleteEvent(event), "danger");
  no.append(element("kbd", { textContent: "Del" }));
  no.dataset.action = "delete";
  const move = makeButton(`Happened at frame ${frame()} `, "", () => moveEvent(event, frame()));
  move.append(element("kbd", { textContent: "V" }));
  move.dataset.action = "move";
  row.append(no, move);
  const exact = element("form", { className: "row" });
  const field = element("input", { id: "exact", type: "number", step: "0.05", min: "0", defaultValue: event.frame.toFixed(2) });
  exact.append(element("label", { textContent: "At frame", htmlFor: "exact" }), field, makeButton("Set", "", () => {}));
  exact.addEventListener("submit", (submitted) => {
    submitted.preventDefault();
    field.blur();
    if (field.value !== "") moveEvent(event, Number(field.value));
  });
  box.append(row, exact);
}

// ---------------------------------------------------------------- mouse and touch

function pixelAt(event) {
  const box = $("overlay").getBoundingClientRect();
  const [width, height] = run().image;
  return [(event.clientX - box.left) / box.width * width - 0.5, (event.clientY - box.top) / box.height * height - 0.5];
}

function ballAt([x, y]) {
  const scale = imageScale();
  let best = null;
  for (const ball of run().balls) {
    const point = pointHere(ball.id);
    const distance = point && Math.hypot(point[1] - x, point[2] - y);
    if (point && distance < Math.max(1.3 * ball.radius, 16 * scale) && (!best || distance < best[0])) best = [distance, ball.id];
  }
  return best?.[1] ?? null;
}

function round(value) { return Math.round(100 * value) / 100; }

function saveCorners() {
  const moved = page.corners?.map((corner) => corner.map(round));
  if (moved) change((c) => { c.corners = moved; });
}

function moveCorner(k, dx, dy) {
  const all = $("all-corners").checked;
  page.corners = corners().map(([x, y], number) => all || number === k ? [x + dx, y + dy] : [x, y]);
}

let drag = null;
$("overlay").addEventListener("pointerdown", (event) => {
  if (!run() || event.button) return;
  const at = pixelAt(event);
  const corner = event.target.dataset.corner;
  if (corner !== undefined && !page.ask) {
    drag = { corner: Number(corner), last: at, moved: false };
  } else if (page.ask?.point) {
    drag = { point: true };
    page.cross = at;
    magnify(at);
    draw();
  } else return;
  event.preventDefault();
  $("overlay").setPointerCapture(event.pointerId);
});
$("overlay").addEventListener("pointermove", (event) => {
  if (!run()) return;
  const at = pixelAt(event);
  if (drag?.corner !== undefined) {
    moveCorner(drag.corner, at[0] - drag.last[0], at[1] - drag.last[1]);
    drag = { ...drag, last: at, moved: true };
    magnify(page.corners[drag.corner]);
    draw();
  } else if (page.ask?.point && (drag || event.pointerType === "mouse")) {
    page.cross = at;
    magnify(at);
    draw();
  }
});
$("overlay").addEventListener("pointerup", () => {
  if (drag?.corner !== undefined) {
    magnify(null);
    if (drag.moved) saveCorners();
  } else if (drag?.point) placeBall();
  drag = null;
});
$("overlay").addEventListener("pointercancel", () => { drag = null; magnify(null); });
$("overlay").addEventListener("pointerleave", () => { if (!drag) magnify(null); });
$("overlay").addEventListener("click", (event) => {
  if (!run() || page.ask?.point || event.target.dataset.corner !== undefined) return;
  const id = ballAt(pixelAt(event));
  if (id) pickBall(id);
  else if (event.target.dataset.cushion) pickCushion(event.target.dataset.cushion);
  else if (!page.ask) {
    page.ball = page.event = page.place = null;
    render(false);
  }
});

function startPlacing() {
  if (!run()) return;
  page.ball = page.event = null;
  page.cross = [run().image[0] / 2, run().image[1] / 2];
  ask({ point: true, text: "Click the centre of the missed ball; or move the cross with the arrow keys and press Enter" });
}

function placeBall() {
  const [x, y] = page.cross.map(round);
  page.ask = page.cross = null;
  magnify(null);
  finishQuestion((c) => add(c, "balls", { kind: "placed", ball: { frame: frame(), x_px: x, y_px: y } }));
}

// ---------------------------------------------------------------- keys and controls

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
let cornerTimer = null;

document.addEventListener("keydown", (event) => {
  const target = event.target;
  if (!run() || target.matches("input:not([type=range]):not([type=checkbox]), select") || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if ((event.ctrlKey || event.metaKey) && !["z", "y"].includes(key)) return;
  if (handleKey(key, event)) event.preventDefault();
});

function handleKey(key, event) {
  const arrow = ARROWS[key];
  const corner = event.target.dataset?.corner;
  if (arrow && corner !== undefined) {
    const step = event.shiftKey ? 5 : 0.5;
    moveCorner(Number(corner), arrow[0] * step, arrow[1] * step);
    magnify(page.corners[Number(corner)]);
    draw();
    clearTimeout(cornerTimer);
    cornerTimer = setTimeout(() => { magnify(null); saveCorners(); }, 700);
    return true;
  }
  if (page.ask?.point && arrow) {
    const step = event.shiftKey ? 10 : 1;
    page.cross = [page.cross[0] + arrow[0] * step, page.cross[1] + arrow[1] * step];
    magnify(page.cross);
    draw();
    return true;
  }
  if (page.ask?.point && key === "Enter") { placeBall(); return true; }
  if (key === "ArrowLeft" || key === "ArrowRight") {
    if (event.target.id === "zoom") return false;
    show(page.row + arrow[0] * (event.shiftKey ? 10 : 1));
    renderSelection();
    return true;
  }
  if (key === "Escape") { cancel(); return true; }
  if (key === "z" || key === "y") { act(event.shiftKey || key === "y" ? "redo" : "undo"); return true; }
  if (key === " " && event.target.tagName !== "BUTTON") { play(); return true; }
  if (key === "n" || key === "p") { goToCheck(page.check + (key === "n" ? 1 : -1)); return true; }
  if (key === "e") { stepEvent(event.shiftKey ? -1 : 1); return true; }
  if (key === "b") { startPlacing(); return true; }
  const numbered = page.keys.find((one) => String(one[0]) === key);
  if (numbered) { pickBall(numbered[2]); return true; }
  const remove = key === "Delete" || key === "Backspace";
  if (page.event && remove) { deleteEvent(page.event); return true; }
  if (page.event && key === "v") { moveEvent(page.event, frame()); return true; }
  const action = Object.values(BALL_ACTIONS).find((one) => one.key === key || remove && one.key === "Delete");
  if (page.ball && action && !page.ask) { action.run(page.ball); return true; }
  return false;
}

function stepEvent(step) {
  const next = step > 0 ? run().events.find((one) => Math.round(one.frame) > frame())
    : run().events.findLast((one) => Math.round(one.frame) < frame());
  if (next) chooseEvent(next);
}

function play() {
  if (page.timer) {
    clearInterval(page.timer);
    page.timer = null;
  } else {
    if (page.row >= frames().length - 1) show(0);
    page.timer = setInterval(() => {
      show(page.row + 1);
      if (page.row >= frames().length - 1) play();
    }, PLAY_MS);
  }
  $("play").textContent = page.timer ? "⏸ Stop" : "▶ Play";
  $("play").setAttribute("aria-label", page.timer ? "Stop" : "Play");
}

const setOrClear = (key, value) => change((c) => { if (value === "" || value === null) delete c[key]; else c[key] = value; });
$("slider").addEventListener("input", () => { show(Number($("slider").value)); renderSelection(); });
$("zoom").addEventListener("input", fitStage);
$("labels").addEventListener("change", draw);
$("back").addEventListener("click", () => { show(page.row - 1); renderSelection(); });
$("forward").addEventListener("click", () => { show(page.row + 1); renderSelection(); });
$("event-before").addEventListener("click", () => stepEvent(-1));
$("event-after").addEventListener("click", () => stepEvent(1));
$("play").addEventListener("click", play);
$("place").addEventListener("click", startPlacing);
$("next-check").addEventListener("click", () => goToCheck(page.check + 1));
$("cancel").addEventListener("click", cancel);
$("undo").addEventListener("click", () => act("undo"));
$("redo").addEventListener("click", () => act("redo"));
$("finish").addEventListener("click", () => act("finish"));
$("message").lastElementChild.addEventListener("click", hideMessage);
$("table").addEventListener("change", () => setOrClear("table", $("table").value));
$("table-size").addEventListener("change", () => setOrClear("table", $("table-size").value.trim()));
$("radius").addEventListener("change", () => setOrClear("ball_radius", $("radius").value === "" ? null : Number($("radius").value) / 2000));
$("fps").addEventListener("change", () => setOrClear("fps", $("fps").value));
$("fps-other").addEventListener("change", () => setOrClear("fps", $("fps-other").value.trim()));
$("find-table").addEventListener("click", () => { page.corners = null; setOrClear("corners", null); });
new ResizeObserver(fitStage).observe($("scroller"));
hint("");
poll();
