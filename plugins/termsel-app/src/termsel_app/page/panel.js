// @ts-check
/** The panel of quality, the form of the selected feature, and the table of the control. */

/** @param {string} id @returns {any} */
export const byId = id => document.getElementById(id);

/**
 * Make an element; text is text, whatever it holds.
 * @param {string} tag
 * @param {Record<string, any>} [properties]
 * @param {(Node | string)[]} [children]
 * @returns {any}
 */
export function make(tag, properties = {}, children = []) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key === "class") element.className = value;
    else if (key.startsWith("aria-") || key === "for" || key === "scope") element.setAttribute(key, value);
    else element[key] = value;
  }
  element.append(...children);
  return element;
}

/** What the page calls the roles of files and options. @type {Record<string, string>} */
const ROLES = { control: "control", check: "selection", independent: "independent check", off: "off" };

/** A size in px or metres, rounded as on the screens of termsel. @param {number} value */
export function sized(value) {
  if (!Number.isFinite(value)) return "-";
  if (value >= 99.95) return Math.round(value).toLocaleString("en");
  if (value >= 9.995) return value.toFixed(1);
  if (value >= 0.0995) return value.toFixed(2);
  return value >= 1e-4 ? value.toPrecision(2) : Number(value.toPrecision(2)).toString();
}

/** A coordinate with as many digits as its size needs. @param {number | null | undefined} value */
export function coordinate(value) {
  if (value === null || value === undefined) return "";
  return value.toFixed(Math.abs(value) <= 360 && !Number.isInteger(value) ? 6 : 2);
}

/** A measurement in a field: what is left out is below anything that counts. @param {number | null | undefined} value @param {boolean} inImage */
export function measurement(value, inImage) {
  if (value === null || value === undefined) return "";
  return Number(value.toFixed(inImage || Math.abs(value) > 360 ? 3 : 9)).toString();
}

/** A place in the image. @param {number | undefined} value */
export const pixel = value => value === undefined || value === null ? "" : value.toFixed(2);

/** @param {string} text @param {() => void} act @param {Record<string, any>} [more] */
export function button(text, act, more = {}) {
  return make("button", { type: "button", textContent: text, onclick: act, ...more });
}

/**
 * Say how accurate the model is, or what is missing.
 * @param {Record<string, any>} answers
 */
export function showAccuracy(answers) {
  const place = byId("accuracy");
  const { figures, waiting, refused } = answers;
  if (refused) {
    place.replaceChildren(make("div", { class: "card bad" }, [
      make("p", {}, [make("strong", { textContent: refused.text }), " ", refused.hint ?? ""])]));
  } else if (waiting) {
    place.replaceChildren(make("p", { class: "quiet", textContent: waiting.text }));
  } else if (!figures) {
    place.replaceChildren(make("p", { class: "quiet", textContent: "Computing…" }));
  } else if (!figures.accuracy) {
    place.replaceChildren(make("p", { textContent: "Not known yet: one more point, and there is a figure." }));
  } else {
    const { px, metres, kind, level } = figures.accuracy;
    const percent = Math.round(level * 100);
    place.replaceChildren(
      make("p", { class: "figure" }, [`${sized(px[0])} px`, metres ? make("small", {
        textContent: `  ≈ ${sized(metres[0])} m` }) : ""]),
      make("p", { class: "interval", textContent: `${percent} % interval ${sized(px[1])} to ${sized(px[2])} px` }),
      ...(metres ? [make("p", { class: "interval", textContent: `≈ ${sized(metres[1])} to ${sized(metres[2])} m on the ground` })] : []),
      make("p", { class: "quiet", textContent: `RMSE ${kind}` }));
  }
}

/**
 * Name what is wrong, with what to do about it.
 * @param {any[]} blunders
 * @param {{goTo: (id: string) => void, leaveOut: (id: string) => void}} acts
 */
export function showBlunders(blunders, acts) {
  byId("blunder-section").hidden = !blunders.length;
  byId("blunders").replaceChildren(...blunders.map(blunder => make("div", { class: "card bad" }, [
    make("p", {}, [make("strong", { textContent: `${blunder.id} is off by ${sized(blunder.error)} px` }),
      ` (${blunder.certainty}).${blunder.excluded ? " The model does without it." : ""}`]),
    make("div", { class: "row" }, [
      button("Go to", () => acts.goTo(blunder.id), { "aria-label": `Go to ${blunder.id}` }),
      button("Leave out", () => acts.leaveOut(blunder.id), { "aria-label": `Leave ${blunder.id} out` })])])));
}

/**
 * Say where to measure next, and whether that is worth while.
 * @param {any} next
 * @param {(number: number) => void} goTo
 */
export function showNextPlaces(next, goTo) {
  byId("next-section").hidden = !next;
  if (!next) return;
  const { enough } = next;
  const children = [make("p", { class: enough.reached ? "card good" : "", textContent: enough.reached
    ? `Enough: one more point gains less than 5 %. ${enough.text}` : enough.text })];
  if (next.next.length) {
    children.push(make("ol", {}, next.next.map((place, i) => make("li", {}, [
      make("span", { textContent: `${i + 1}  line ${Math.round(place.line)}, sample ${Math.round(place.sample)}` }),
      button("Go to", () => goTo(i), { "aria-label": `Go to place ${i + 1}` })]))));
  }
  byId("next").replaceChildren(...children);
}

/** Name the model and say why; of lines, those that OWDIS uses. @param {any} figures @param {any} lines */
export function showModel(figures, lines) {
  byId("model-section").hidden = !figures;
  if (!figures) return;
  /** A fact may go on in lines whose label is blank. @type {{label: string, text: string}[]} */
  const facts = [];
  for (const { label, text } of figures.facts) {
    if (label.trim()) facts.push({ label, text });
    else if (label && facts.length) facts[facts.length - 1].text += ` ${text}`;
  }
  const parts = facts.filter(fact => ["Model", "Compared"].includes(fact.label)).map(fact =>
    make("p", {}, [make("strong", { textContent: `${fact.label} ` }), fact.text]));
  if (lines) parts.push(make("p", {}, [make("strong", { textContent: "Lines " }), lines.text]));
  const why = [figures.why, figures.judgement].filter(Boolean);
  parts.push(make("details", {}, [make("summary", { textContent: "Why, and what to know" }),
    make("ul", {}, [...why, ...figures.notes].map(text => make("li", { textContent: text })))]));
  byId("model").replaceChildren(...parts);
}

const FIELDS = [["line", "Line"], ["sample", "Sample"], ["x", "X"], ["y", "Y"], ["z", "Z"]];

/**
 * Show the form of the selected feature.
 * @param {any} record
 * @param {any} error
 * @param {number | undefined} own its error where the others predict it
 * @param {{put: (given: object) => void, remove: () => void, refine: (() => void) | null}} acts
 */
export function showSelected(record, error, own, acts) {
  byId("selected-section").hidden = !record;
  const form = byId("selected");
  if (!record) {
    form.replaceChildren();
    return;
  }
  const focused = form.contains(document.activeElement) ? document.activeElement?.id : null;
  const field = (id, label, value, change) => [
    make("label", { for: id, textContent: label }),
    make("input", { id, value, autocomplete: "off", spellcheck: false, onchange: event => change(event.target.value.trim()) })];
  const roles = record.kind === "line" ? [["", "control"], ["off", "off"]]
    : [["", "automatic"], ...Object.entries(ROLES)];
  const role = make("select", { id: "field-role", onchange: event => acts.put({ role: event.target.value }) },
    roles.map(([value, text]) => make("option", { value, textContent: text, selected: value === record.role })));
  const children = [
    ...field("field-id", "Id", record.id, value => acts.put({ name: value })),
    make("label", { for: "field-role", textContent: "Role" }), role];
  if (record.kind === "point") {
    const values = measured(record);
    for (const [key, label] of FIELDS) {
      const text = measurement(values[key], key === "line" || key === "sample");
      children.push(...field(`field-${key}`, label, text, () => acts.put(typed(record))));
    }
  }
  if (error) {
    children.push(make("p", { class: "row quiet", textContent: own === undefined ? `residual ${sized(error.distance)} px`
      : `residual ${sized(error.distance)} px; the others predict it to ${sized(own)} px` }));
  }
  const missing = record.kind === "line" ? missingEnds(record) : !record.image ? "Now click it in the image."
    : !record.ground ? "Now click it in the map, or type its coordinates." : "";
  if (missing) children.push(make("p", { class: "row", textContent: missing }));
  const refine = acts.refine ? [button("Refine by the image", acts.refine, { id: "refine",
    title: "Match the map's place with the image to a part of a pixel" })] : [];
  children.push(make("div", { class: "row" }, [
    button(record.role === "off" ? "Use it again" : "Leave out", () => acts.put({ role: record.role === "off" ? "" : "off" })),
    button("Delete", acts.remove), ...refine]));
  form.onsubmit = event => event.preventDefault();
  form.replaceChildren(...children);
  if (focused) byId(focused)?.focus();
}

/** @param {any} record */
function missingEnds(record) {
  const image = record.image?.length ?? 0;
  const map = record.map?.length ?? 0;
  if (image < 2) return `Click ${2 - image} more ${image === 1 ? "end" : "ends"} in the image: anywhere along the line.`;
  if (map < 2) return `Click ${2 - map} more ${map === 1 ? "end" : "ends"} in the map. Ends need not correspond.`;
  return "";
}

/** The measurements of a point, by the names of their fields. @param {any} record @returns {Record<string, number | null | undefined>} */
function measured(record) {
  return { line: record.image?.[0], sample: record.image?.[1], x: record.ground?.[0], y: record.ground?.[1], z: record.ground?.[2] };
}

/** What the form says of a point; blank fields are not known. @param {any} record */
function typed(record) {
  const text = key => byId(`field-${key}`).value.trim();
  const values = measured(record);
  const number = key => {
    if (text(key) === "") return null;
    // A field that nobody changed shows fewer digits than the measurement has.
    const isUnchanged = text(key) === measurement(values[key], key === "line" || key === "sample");
    return isUnchanged ? values[key] ?? null : Number(text(key).replace(",", "."));
  };
  /** @type {{image?: any, ground?: any}} */
  const given = {};
  if (text("line") !== "" && text("sample") !== "") given.image = [number("line"), number("sample")];
  if (text("x") !== "" && text("y") !== "") given.ground = [number("x"), number("y"), number("z")];
  // A place that was typed on the ground takes its height from the DEM where none is typed.
  if (given.ground && record.ground && JSON.stringify(given.ground) === JSON.stringify(record.ground)) delete given.ground;
  if (given.image && record.image && JSON.stringify(given.image) === JSON.stringify(record.image)) delete given.image;
  return given;
}

/** What the table is sorted by. */
const order = { key: "", down: false };

/**
 * Show the table of the control.
 * @param {any[]} records
 * @param {Record<string, any>} errors
 * @param {Record<string, number>} own errors where the others predict a feature
 * @param {Record<string, string>} roles that termsel has assigned
 * @param {string[] | null} lines that OWDIS uses, once it has chosen
 * @param {string | null} chosen
 * @param {(id: string) => void} choose
 */
export function showTable(records, errors, own, roles, lines, chosen, choose) {
  byId("empty").hidden = records.length > 0;
  const rows = records.map(record => {
    const [image, ground] = record.kind === "point" ? [record.image ?? [], record.ground ?? []] : [[], []];
    const error = errors[record.id] ?? {};
    return { record, id: record.id, role: record.role, line: image[0], sample: image[1], x: ground[0], y: ground[1],
      z: ground[2], distance: error.distance, own: own[record.id], blunder: error.blunder };
  });
  if (order.key) rows.sort((a, b) => compared(a[order.key], b[order.key]) * (order.down ? -1 : 1));
  byId("rows").replaceChildren(...rows.map(row => tableRow(row, roles, lines, chosen, choose)));
  for (const head of document.querySelectorAll("[data-sort]")) {
    const on = /** @type {HTMLElement} */ (head).dataset.sort === order.key;
    head.closest("th")?.setAttribute("aria-sort", on ? (order.down ? "descending" : "ascending") : "none");
  }
}

/** @param {any} a @param {any} b */
function compared(a, b) {
  if (a === b) return 0;
  if (a === undefined || a === null) return 1;
  if (b === undefined || b === null) return -1;
  return typeof a === "string" ? a.localeCompare(b, "en", { numeric: true }) : a - b;
}

/** @param {any} row @param {Record<string, string>} roles @param {string[] | null} lines
 * @param {string | null} chosen @param {(id: string) => void} choose */
function tableRow(row, roles, lines, chosen, choose) {
  const { record } = row;
  const role = record.role || (record.kind === "line" ? "control" : roles[record.id] ?? "");
  const line = !lines || role === "off" ? `line, ${role}` : lines.includes(record.id) ? "line, used by OWDIS" : "line, not used by OWDIS";
  const said = record.kind === "line" ? line : record.role || !role ? ROLES[role] ?? ""
    : role === "off" ? "left out as a blunder" : `${ROLES[role]} (auto)`;
  const number = (text, wrong = false) => make("td", { class: wrong ? "number wrong" : "number", textContent: text });
  return make("tr", {
    class: [record.id === chosen ? "chosen" : "", row.blunder ? "bad" : "", record.role === "off" ? "off" : ""].join(" "),
    onclick: () => choose(record.id) }, [
    make("td", {}, [make("button", { type: "button", textContent: record.id, "aria-pressed": String(record.id === chosen) })]),
    make("td", { textContent: said }), number(pixel(row.line)), number(pixel(row.sample)), number(coordinate(row.x)),
    number(coordinate(row.y)), number(row.z === null || row.z === undefined ? "" : row.z.toFixed(2)),
    number(row.distance === undefined ? "" : sized(row.distance), Boolean(row.blunder)),
    number(row.own === undefined ? "" : sized(row.own), Boolean(row.blunder))]);
}

/** Let the heads of the table sort it. @param {() => void} again */
export function letSort(again) {
  for (const head of document.querySelectorAll("[data-sort]")) {
    head.addEventListener("click", () => {
      const key = /** @type {HTMLElement} */ (head).dataset.sort ?? "";
      order.down = order.key === key ? !order.down : ["distance", "own"].includes(key);
      order.key = key;
      again();
    });
  }
}

/** Say what went wrong, until the user has seen it. @param {string} text */
export function alertUser(text) {
  byId("alert").hidden = !text;
  byId("alert").querySelector("p").textContent = text;
}
