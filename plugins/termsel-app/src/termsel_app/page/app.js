// @ts-check
/** The page: its state, and what clicks and keys do. */

import { call, listen, newest } from "./server.js";
import {
  Pane, drawLines, gridLayer, letDrag, limits, ramp, showControl, showNext, showPrediction, showProposals, served, tiles,
} from "./panes.js";
import {
  alertUser, button, byId, letSort, make, pixel, showAccuracy, showBlunders, showModel, showNextPlaces, showSelected,
  showTable, sized,
} from "./panel.js";

const ol = /** @type {any} */ (window).ol;

/** @typedef {[number, number]} Place */
/** @typedef {{id: string, kind: string, role: string, image: any, ground: any, map: any}} Feature */

const state = {
  version: -1,
  /** The version whose control is being judged, or was last. */
  asked: -1,
  /** @type {Feature[]} */ records: [],
  /** @type {Record<string, any>} */ answers: {},
  /** @type {any} */ setting: null,
  /** @type {string | null} */ chosen: null,
  tool: "point",
  undo: 0,
  redo: 0,
};
/** What waits for a version of the control to arrive. @type {{version: number, go: () => void}[]} */
let awaited = [];
/** @type {{image: Pane, map: Pane}} */
const panes = /** @type {any} */ ({});
/** @type {any} */
let warped = null;
/** @type {any} */
let uncertain = null;
/** @type {any[]} */
const vectorSources = [];

/** @param {any} place of the image, line and sample @returns {Place} */
const onScreen = place => [place[1], -place[0]];
/** @param {any} coordinate @returns {Place} */
const inImage = coordinate => [-coordinate[1], coordinate[0]];
const recordOf = id => state.records.find(record => record.id === id) ?? null;
const places = (record, side) => !record[side] ? [] : record.kind === "point" ? [record[side]] : record[side];

/** Do something, and say what is refused. @param {() => Promise<any>} task */
async function attempt(task) {
  try {
    const answer = await task();
    alertUser(answer?.note ?? "");
    return answer;
  } catch (error) {
    alertUser(error instanceof Error ? error.message : String(error));
    draw(); // what was dragged goes back
    return null;
  }
}

async function begin() {
  const all = await (await fetch("state")).json();
  state.setting = all.setting;
  take({ kind: "control", ...all });
  state.answers = all.answers;
  makePanes(all.setting);
  describe(all.setting);
  letSort(draw);
  connect();
  draw();
  listen(message => take(message), lost => {
    byId("saved").textContent = lost ? "no connection" : "all changes saved";
    if (!lost && state.version >= 0) refresh();
  });
  document.documentElement.dataset.ready = "yes";
}

async function refresh() {
  const all = await (await fetch("state")).json();
  state.answers = all.answers;
  take({ kind: "control", ...all });
  draw();
}

/** Take what the server says. @param {any} message */
function take(message) {
  if (message.kind === "control") {
    if (message.version < state.version) return;
    Object.assign(state, { version: message.version, asked: message.asked, records: message.records, undo: message.undo, redo: message.redo });
    for (const { version, go } of awaited) if (version <= state.version) go();
    awaited = awaited.filter(({ version }) => version > state.version);
    if (state.chosen && !recordOf(state.chosen)) state.chosen = null;
  } else {
    if (["figures", "waiting", "refused"].includes(message.stage)) {
      state.answers = {};
    }
    state.answers[message.stage] = message;
    if (message.stage === "figures") {
      warped?.source.setUrl(`tile/warped/{z}/{x}/{y}.png?v=${message.serial}`);
      drawThrough();
      showWhereAgain();
    }
  }
  if (panes.image) draw();
}

/** Wait until the page has a version of the control: it comes on another way than answers do. @param {number} version */
function arrival(version) {
  return version <= state.version ? Promise.resolve() : new Promise(go => awaited.push({ version, go: () => go(null) }));
}

/** @param {any} setting */
function makePanes(setting) {
  const [lines, samples] = setting.image.size ?? [1000, 1000];
  const box = [-0.5, -(lines - 0.5), samples - 0.5, 0.5];
  const projection = new ol.proj.Projection({ code: "image", units: "pixels", extent: box, metersPerUnit: 1 });
  const image = setting.image.tiles
    ? [tiles(projection, `tile/image/{z}/{x}/{y}.png`, [-0.5, 0.5], setting.image.resolutions, box)]
    : setting.image.served ? [served(projection, setting.image.served, box)] : [];
  panes.image = new Pane({ name: "image", extent: box, box, resolutions: setting.image.resolutions, origin: [-0.5, 0.5],
    sources: image, flat: true, projection });
  const around = setting.map.box;
  // Tiles of a server are in Web Mercator; all else is in the CRS that is shown, whose name the library need not know.
  const map = setting.map.tiles.length ? ol.proj.get("EPSG:3857")
    : new ol.proj.Projection({ code: "map", units: "m", extent: around, metersPerUnit: 1 });
  /** @type {[Place, number[], number[]]} */
  const grid = [[around[0], around[3]], setting.map.resolutions, around];
  const sources = [
    ...setting.map.tiles.map(url => new ol.source.XYZ({ url, projection: "EPSG:3857" })),
    ...setting.map.rasters.map((_, i) => tiles(map, `tile/map${i}/{z}/{x}/{y}.png`, ...grid))];
  panes.map = new Pane({ name: "map", extent: around, box: around, resolutions: setting.map.resolutions,
    origin: grid[0], sources, flat: false, projection: map });
  for (const vectors of setting.map.vectors) {
    const source = new ol.source.Vector({ features: new ol.format.GeoJSON().readFeatures(vectors.collection) });
    vectorSources.push(source);
    panes.map.map.addLayer(new ol.layer.Vector({ source, zIndex: 4, style: new ol.style.Style({
      stroke: new ol.style.Stroke({ color: "#d95f02", width: 1.6 }), fill: new ol.style.Fill({ color: "#d95f0218" }),
      image: new ol.style.Circle({ radius: 3.5, fill: new ol.style.Fill({ color: "#d95f02" }) }) }) }));
  }
  if (setting.image.tiles) warped = warpedLayer(map, grid);
}

/** The image on the map, below a swipe. @param {any} projection @param {any} grid */
function warpedLayer(projection, grid) {
  const source = tiles(projection, "tile/warped/{z}/{x}/{y}.png", grid[0], grid[1], grid[2]);
  const layer = new ol.layer.Tile({ source, visible: false, opacity: 0.7, zIndex: 2 });
  layer.on("prerender", event => {
    const context = event.context;
    const share = Number(byId("swipe").value) / 100;
    context.save();
    context.beginPath();
    context.rect(0, 0, context.canvas.width * share, context.canvas.height);
    context.clip();
  });
  layer.on("postrender", event => event.context.restore());
  panes.map.map.addLayer(layer);
  return { layer, source };
}

/** @param {any} setting */
function describe(setting) {
  byId("title").textContent = setting.image.name ?? setting.folder;
  document.title = `${setting.image.name ?? "control"} · termsel app`;
  if (setting.image.name) {
    const [height, width] = setting.image.size.map(n => n.toLocaleString("en"));
    byId("image-name").textContent = `${setting.image.name}, ${width} × ${height} px`;
  } else byId("image-name").textContent = "no image given";
  const names = [...setting.map.rasters, ...setting.map.vectors.map(layer => layer.name)];
  byId("map-name").textContent = [names.join(", ") || "coordinates", setting.crs.length < 30 ? setting.crs : ""]
    .filter(Boolean).join(" · ");
  byId("attribution").textContent = setting.map.tiles.length ? `Tiles: ${setting.map.tiles.map(url =>
    new URL(url.replace(/[{}]/g, "")).host).join(", ")}` : "";
  byId("folder").textContent = setting.folder;
  for (const element of document.querySelectorAll(".crs")) element.textContent = setting.crs;
  if (setting.notes.length) alertUser(setting.notes.join(" "));
  byId("show-graticule").checked = !names.length && !setting.map.tiles.length;
  byId("outputs").replaceChildren(...setting.outputs.map(output => button(output.label, () => saveAs(output))));
}

function connect() {
  for (const side of /** @type {const} */ (["image", "map"])) connectPane(side);
  for (const tool of ["point", "line"]) byId(`tool-${tool}`).onclick = () => chooseTool(tool);
  byId("undo").onclick = () => attempt(() => call("undo"));
  byId("redo").onclick = () => attempt(() => call("redo"));
  byId("fit-image").onclick = () => panes.image.fit();
  byId("fit-map").onclick = () => panes.map.fit();
  byId("alert").querySelector("button").onclick = () => alertUser("");
  for (const name of ["paste", "save", "help"]) {
    byId(`open-${name}`).onclick = () => openDialog(name);
    for (const element of byId(name).querySelectorAll("[data-close]")) element.onclick = () => byId(name).close();
  }
  byId("do-paste").onclick = paste;
  byId("copy").onclick = () => navigator.clipboard?.writeText(byId("command").textContent);
  byId("show-residuals").onchange = draw;
  byId("show-uncertainty").onchange = draw;
  byId("show-lines").onchange = drawThrough;
  byId("show-graticule").onchange = drawThrough;
  byId("show-warped").onchange = event => warped?.layer.setVisible(event.target.checked);
  byId("opacity").oninput = event => warped?.layer.setOpacity(Number(event.target.value) / 100);
  byId("swipe").oninput = () => panes.map.map.render();
  panes.map.map.on("moveend", () => byId("show-graticule").checked && drawThrough());
  document.addEventListener("keydown", onKey);
  document.addEventListener("click", event => {
    for (const menu of document.querySelectorAll("details.layers[open]")) {
      if (!menu.contains(/** @type {Node} */ (event.target))) menu.removeAttribute("open");
    }
  });
  drawThrough();
}

/** @param {"image" | "map"} side */
function connectPane(side) {
  const pane = panes[side];
  const other = side === "image" ? panes.map : panes.image;
  const predict = newest("predict", answer => showPrediction(other, shown(answer.prediction, side)));
  pane.map.on("pointermove", event => {
    if (event.dragging) return;
    const place = event.coordinate;
    predict(side === "image" ? { image: inImage(place) } : { map: place });
    byId(`${side}-cursor`).textContent = side === "image" ? `line ${pixel(-place[1])}, sample ${pixel(place[0])}`
      : `${place[0].toFixed(1)}, ${place[1].toFixed(1)}`;
    pane.magnify(byId("show-loupe").checked ? place : null);
    pane.map.getTargetElement().style.cursor = pane.at(event.pixel) ? "grab" : "crosshair";
  });
  pane.map.getViewport().addEventListener("pointerleave", () => {
    pane.magnify(null);
    byId(`${side}-cursor`).textContent = "";
    if (!waitsFor(side === "image" ? "map" : "image")) showPrediction(other, null);
  });
  pane.map.on("click", event => {
    const feature = pane.at(event.pixel);
    if (feature) choose(feature.getId());
    else clicked(side, event.coordinate);
  });
  letDrag(pane, (id, dropped) => {
    state.chosen = id;
    attempt(() => call("put", { id, ...at(side, recordOf(id), dropped) }));
  });
}

/** A prediction as it is drawn. @param {any} prediction @param {"image" | "map"} from */
function shown(prediction, from) {
  if (!prediction || from === "image") return prediction;
  return { place: onScreen(prediction.place), ring: prediction.ring.map(onScreen) };
}

/** What to send of places of a pane. @param {"image" | "map"} side @param {any} record @param {Place[]} coordinates */
function at(side, record, coordinates) {
  const sent = side === "image" ? coordinates.map(inImage)
    : coordinates.map(place => byId("snap").checked ? panes.map.snapped(place, vectorSources) : place);
  return { [side]: record?.kind === "line" ? sent : sent[0] };
}

/** Whether the selected feature still needs a place in a pane. @param {"image" | "map"} side */
function waitsFor(side) {
  const record = recordOf(state.chosen);
  if (!record) return false;
  return record.kind === "point" ? !record[side] : (record[side]?.length ?? 0) < 2;
}

/** The clicks before, which decide what the next one means. */
let clicks = Promise.resolve();

/** Measure where the user has clicked, after the clicks before. @param {"image" | "map"} side @param {Place} coordinate */
function clicked(side, coordinate) {
  const tool = state.tool;
  clicks = clicks.then(() => measure(side, coordinate, tool)).catch(error => alertUser(String(error)));
}

/** @param {"image" | "map"} side @param {Place} coordinate @param {string} tool that was chosen when the user clicked */
async function measure(side, coordinate, tool) {
  const record = recordOf(state.chosen);
  const other = side === "image" ? "map" : "image";
  let given;
  if (record && waitsFor(side)) {
    const before = record.kind === "line" ? (record[side] ?? []).map(place => side === "image" ? onScreen(place) : place) : [];
    given = { id: record.id, ...at(side, record, [...before, coordinate]) };
  } else if (record && record.kind === "point" && waitsFor(other)) {
    given = { id: record.id, ...at(side, record, [coordinate]) }; // clicked once more, where it belongs
  } else {
    given = { kind: tool, ...at(side, { kind: tool }, [coordinate]) };
  }
  const answer = await attempt(() => call("put", given));
  if (!answer) return;
  await arrival(answer.version);
  state.chosen = answer.id;
  draw();
  if (waitsFor(other) && !waitsFor(side)) showWhere(side, coordinate, true);
}

/**
 * Show in the other pane where a place must be.
 * @param {"image" | "map"} side
 * @param {Place} coordinate
 * @param {boolean} go there, too: never while the user may be about to click
 */
async function showWhere(side, coordinate, go) {
  const { prediction } = await call("predict", side === "image" ? { image: inImage(coordinate) } : { map: coordinate })
    .catch(() => ({ prediction: null }));
  if (!prediction) return;
  const other = side === "image" ? panes.map : panes.image;
  const there = shown(prediction, side);
  showPrediction(other, there);
  if (!go) return;
  const width = there.ring.length ? Math.max(...there.ring.map(place => Math.abs(place[0] - there.place[0]))) * 2 : undefined;
  other.goTo(there.place, width && width * 3);
}

/** Show it for the place that waits for its other pane, once there is a new model. */
function showWhereAgain() {
  const record = recordOf(state.chosen);
  if (!record || record.kind !== "point" || !panes.map) return;
  if (record.image && !record.map) showWhere("image", onScreen(record.image), false);
  if (record.map && !record.image) showWhere("map", record.map, false);
}

/** @param {string | null} id */
function choose(id) {
  state.chosen = id;
  draw();
}

/** Select a feature and show it in both panes. @param {string} id */
function goTo(id) {
  choose(id);
  const record = recordOf(id);
  if (!record) return;
  for (const side of /** @type {const} */ (["image", "map"])) {
    const [first] = places(record, side);
    if (!first) continue;
    const size = panes[side].map.getSize() ?? [400, 400];
    const place = side === "image" ? onScreen(first) : first;
    panes[side].goTo(place, size[0] * 0.35 * panes[side].view.getResolution() / 2);
  }
}

/** @param {string} tool */
function chooseTool(tool) {
  state.tool = tool;
  state.chosen = null;
  for (const name of ["point", "line"]) byId(`tool-${name}`).setAttribute("aria-pressed", String(name === tool));
  draw();
}

/** Show all that there is. */
function draw() {
  const { figures, next, uncertainty } = state.answers;
  const errors = figures?.errors ?? {};
  const own = state.answers.predicted?.errors ?? {};
  const used = Object.values(errors).filter(error => error.line !== null && !error.blunder);
  const largest = Math.max(0, ...used.map(error => error.distance));
  const details = arrows => record => ({ chosen: record.id === state.chosen, error: capped(errors[record.id], largest),
    largest, blunder: errors[record.id]?.blunder, arrows, unused: isUnused(record, state.answers.lines) });
  showControl(panes.image, state.records, record => places(record, "image").map(onScreen),
    details(byId("show-residuals").checked));
  showControl(panes.map, state.records, record => places(record, "map"), details(false));
  showNext(panes.image, (next?.next ?? []).map(place => onScreen([place.line, place.sample])));
  showNext(panes.map, (next?.next ?? []).map(place => place.map));
  showAccuracy(state.answers);
  showBlunders((figures?.blunders ?? []).filter(blunder => recordOf(blunder.id)?.role !== "off"),
    { goTo, leaveOut: id => attempt(() => call("put", { id, role: "off" })) });
  showNextPlaces(next, goToNext);
  showModel(figures, state.answers.lines);
  const record = recordOf(state.chosen);
  showSelected(record, errors[state.chosen ?? ""], own[state.chosen ?? ""], {
    put: given => attempt(async () => {
      const answer = await call("put", { id: state.chosen, ...given });
      state.chosen = answer.id;
      draw();
    }),
    remove: () => remove(),
    refine: state.setting.matching && record?.image && record.map && record.kind === "point" ? refine : null });
  showMatching();
  showTable(state.records, errors, own, figures?.roles ?? {}, state.answers.lines?.chosen ?? null, state.chosen, goTo);
  byId("undo").disabled = !state.undo;
  byId("redo").disabled = !state.redo;
  drawUncertainty(uncertainty?.uncertainty);
  legend(largest, uncertainty?.uncertainty);
  document.documentElement.dataset.version = String(state.version);
  const answered = (figures ?? state.answers.waiting ?? state.answers.refused)?.serial ?? -1;
  document.body.classList.toggle("busy", answered !== state.asked);
  Object.assign(document.documentElement.dataset, { asked: String(state.asked), answered: String(answered) });
}

/** Whether OWDIS does without a line. @param {Feature} record @param {any} lines */
function isUnused(record, lines) {
  return record.kind === "line" && Boolean(lines?.chosen) && !lines.chosen.includes(record.id);
}

/** The arrow of a blunder is no longer than three times that of all others. @param {any} error @param {number} largest */
function capped(error, largest) {
  if (!error || error.line === null || error.distance <= 3 * largest) return error;
  const share = (3 * largest) / error.distance;
  return { ...error, line: error.line * share, sample: error.sample * share };
}

/** @param {any} grid */
function drawUncertainty(grid) {
  const wanted = byId("show-uncertainty").checked ? grid : null;
  if (uncertain?.grid === wanted) return;
  if (uncertain) panes.image.map.removeLayer(uncertain.layer);
  uncertain = wanted ? { grid: wanted, layer: gridLayer(panes.image.projection, wanted) } : null;
  if (uncertain) panes.image.map.addLayer(uncertain.layer);
}

/** @param {number} largest @param {any} grid */
function legend(largest, grid) {
  const parts = [];
  if (largest > 0 && byId("show-residuals").checked) {
    parts.push(make("div", { textContent: `longest arrow: ${sized(largest)} px` }));
  }
  if (grid && byId("show-uncertainty").checked) {
    const { low, high } = limits(grid.values);
    const canvas = make("canvas", { width: 90, height: 1 });
    const context = canvas.getContext("2d");
    for (let i = 0; i < 90; i += 1) {
      context.fillStyle = `rgb(${ramp(i / 89).join(" ")})`;
      context.fillRect(i, 0, 1, 1);
    }
    parts.push(make("div", { class: "ramp" }, [`uncertainty ${sized(low)}`, canvas, `${sized(high)} px`]));
  }
  byId("image-legend").replaceChildren(...parts);
}

/** @param {number} i */
function goToNext(i) {
  const place = state.answers.next.next[i];
  choose(null);
  panes.image.goTo(onScreen([place.line, place.sample]), panes.image.view.getResolution() * 100);
  panes.map.goTo(place.map, panes.map.view.getResolution() * 100);
}

/** Draw graticule and vectors, on the map and through the model. */
async function drawThrough() {
  const wanted = byId("show-lines").checked;
  const graticule = byId("show-graticule").checked;
  if (!wanted && !graticule) {
    drawLines(panes.image, []);
    drawLines(panes.map, []);
    return;
  }
  const box = panes.map.view.calculateExtent(panes.map.map.getSize());
  const [lines, vectors] = await Promise.all([
    graticule || !vectorSources.length ? call("graticule", { box }).catch(() => null) : null,
    wanted && vectorSources.length ? call("vectors").catch(() => null) : null]);
  drawLines(panes.map, graticule ? (lines?.lines ?? []).map(line => ({ label: line.label, places: line.map })) : []);
  drawLines(panes.image, !wanted ? [] : [
    ...(lines?.lines ?? []).map(line => ({ label: line.label, places: (line.image ?? []).map(onScreen) })),
    ...(vectors?.lines ?? []).map(line => ({ places: line.map(onScreen) }))]);
}

/** What matching proposes, until the user says yes or no. */
const matching = {
  text: "",
  busy: false,
  /** @type {any[]} */ points: [],
  /** @type {string | null} */ refines: null,
};

/** Have a click refined by the images. */
async function refine() {
  const id = state.chosen;
  const answer = await attempt(() => call("refine", { id }));
  if (!answer) return;
  Object.assign(matching, { refines: id, points: [answer],
    text: `${id} fits the map ${sized(answer.distance)} px from here (${answer.matcher}).` });
  showPrediction(panes.image, { place: onScreen(answer.image), ring: [] });
  draw();
}

/** Have more points proposed. */
async function findMore() {
  Object.assign(matching, { busy: true, text: "Matching image and map…", points: [], refines: null });
  showMatching();
  const answer = await attempt(() => call("more"));
  const count = answer?.proposals.length ?? 0;
  Object.assign(matching, { busy: false, points: answer?.proposals ?? [], text: !answer ? "" : count
    ? `${count} places look alike in both and agree with the model.` : "Nothing that looks alike agrees with the model." });
  draw();
}

/** @param {boolean} taken */
async function decide(taken) {
  const { refines } = matching;
  /** @type {any[]} */
  const points = matching.points;
  Object.assign(matching, { text: "", points: [], refines: null });
  showPrediction(panes.image, null);
  if (taken) {
    await attempt(() => refines ? call("put", { id: refines, image: points[0].image }) : call("add", { points }));
  }
  draw();
}

function showMatching() {
  byId("match-section").hidden = !state.setting.matching;
  const { text, points, refines, busy } = matching;
  const acts = points.length ? [
    button(refines ? "Accept" : `Add ${points.length} points`, () => decide(true), { id: "accept" }),
    button(refines ? "Refuse" : "Add none", () => decide(false), { id: "refuse" })]
    : [button("Find more points", findMore, { id: "find-more", disabled: busy || !state.answers.figures })];
  byId("match").replaceChildren(...(text ? [make("p", { textContent: text })] : []), make("div", { class: "row" }, acts));
  const shownPoints = refines ? [] : points;
  showProposals(panes.image, shownPoints.map(point => onScreen(point.image)));
  showProposals(panes.map, shownPoints.map(point => point.map));
}

function remove() {
  const id = state.chosen;
  if (id) attempt(() => call("delete", { ids: [id] }));
}

/** @param {string} name */
function openDialog(name) {
  byId(name).showModal();
  if (name !== "save") return;
  byId("save-said").textContent = "";
  call("command").then(answer => { byId("command").textContent = answer.command; })
    .catch(error => { byId("command").textContent = error.message; });
}

async function paste() {
  const answer = await attempt(() => call("paste", { text: byId("pasted").value }));
  if (!answer) return;
  byId("pasted").value = "";
  byId("paste").close();
}

/** @param {{name: string, label: string}} output */
async function saveAs(output) {
  byId("save-said").textContent = `Saving: ${output.label}…`;
  const buttons = [...byId("outputs").querySelectorAll("button")];
  buttons.forEach(element => { element.disabled = true; });
  try {
    const answer = await call("save", { name: output.name, image_id: byId("image-id").value.trim() });
    byId("save-said").textContent = `Saved: ${answer.files.join(", ")}`;
  } catch (error) {
    byId("save-said").textContent = error instanceof Error ? error.message : String(error);
  }
  buttons.forEach(element => { element.disabled = false; });
}

/** The pane that the arrow keys move in: the one under the cursor or with the focus. */
function keyPane() {
  for (const state of [":hover", ":focus-within"]) {
    for (const side of /** @type {const} */ (["image", "map"])) {
      if (byId(`${side}-pane`).matches(state)) return side;
    }
  }
  return "image";
}

/** Move the selected point by pixels of the image, or of the finest map. @param {number} x @param {number} y */
function nudge(x, y) {
  const record = recordOf(state.chosen);
  const side = keyPane();
  if (!record || record.kind !== "point" || !record[side]) return false;
  if (side === "image") {
    attempt(() => call("put", { id: record.id, image: [record.image[0] + y, record.image[1] + x] }));
  } else {
    const unit = state.setting.map.resolutions[state.setting.map.resolutions.length - 1] * 16;
    attempt(() => call("put", { id: record.id, map: [record.map[0] + x * unit, record.map[1] - y * unit] }));
  }
  return true;
}

/** @param {number} step */
function neighbour(step) {
  const ids = state.records.map(record => record.id);
  if (!ids.length) return;
  const at = state.chosen ? ids.indexOf(state.chosen) : step > 0 ? -1 : 0;
  goTo(ids[(at + step + ids.length) % ids.length]);
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** @type {Record<string, () => void>} */
const KEYS = {
  "1": () => chooseTool("point"), "2": () => chooseTool("line"), Escape: () => choose(null), Delete: remove,
  Backspace: remove, n: () => neighbour(1), N: () => neighbour(-1), "?": () => openDialog("help"),
  f: () => { panes.image.fit(); panes.map.fit(); }, l: () => byId("show-loupe").click(),
  u: () => byId("show-uncertainty").click(), w: () => byId("show-warped").click(),
  g: () => byId("show-graticule").click(),
  o: () => {
    const record = recordOf(state.chosen);
    if (record) attempt(() => call("put", { id: record.id, role: record.role === "off" ? "" : "off" }));
  },
};

/** @param {KeyboardEvent} event */
function onKey(event) {
  const target = /** @type {HTMLElement} */ (event.target);
  if (target.closest("input:not([type=checkbox]), select, textarea, dialog")) return;
  if ((event.ctrlKey || event.metaKey) && !event.altKey) {
    const key = event.key.toLowerCase();
    if (key !== "z" && key !== "y") return;
    event.preventDefault();
    attempt(() => call(key === "y" || event.shiftKey ? "redo" : "undo"));
    return;
  }
  if (event.altKey) return;
  const arrow = ARROWS[event.key];
  if (arrow) {
    const step = event.shiftKey ? 1 : 0.1;
    if (nudge(arrow[0] * step, arrow[1] * step)) {
      event.preventDefault();
      event.stopPropagation();
    }
    return;
  }
  const act = KEYS[event.key];
  if (!act) return;
  event.preventDefault();
  act();
}

/** For tests, and for who looks under the bonnet. */
Object.assign(window, { termselPanes: panes, termselState: state });

begin().catch(error => alertUser(`The page could not be opened: ${error.message}`));
