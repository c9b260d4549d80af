// Draws the charts of a page and links their choices with each other and with the tables.
(() => {
  "use strict";
  const { data, charts: specs } = JSON.parse(document.getElementById("charts").textContent);
  for (const spec of Object.values(specs)) {
    spec.datasets = Object.fromEntries(spec.datasets.map((name) => [name, data[name]]));
  }
  const fields = { picked: "id", fit: "fit", member: "member" };
  const views = [];
  const status = document.getElementById("chosen");

  const storeOf = (view, choice) => {
    try { return view.data(choice + "_store"); } catch { return null; }
  };

  const keysIn = (store) => store.flatMap((entry) => entry.values.slice(0, 1));

  const markRows = (choice, keys) => {
    let first = null;
    for (const table of document.querySelectorAll("table[data-choice]")) {
      if (table.dataset.choice !== choice) continue;
      for (const row of table.tBodies[0].rows) {
        const chosen = keys.includes(JSON.parse(row.dataset.key));
        row.classList.toggle("chosen", chosen);
        row.querySelector("button").setAttribute("aria-pressed", String(chosen));
        if (chosen && !first) first = row;
      }
    }
    return first;
  };

  const tell = (row) => {
    if (!row) { status.textContent = ""; return; }
    const heads = [...row.closest("table").tHead.rows[0].cells].map((cell) => cell.textContent);
    status.textContent = [...row.cells]
      .map((cell, i) => (i ? heads[i] + " " : "") + cell.textContent).slice(0, 6).join("; ");
  };

  const choose = (choice, keys, source, told = true) => {
    for (const view of views) {
      const store = storeOf(view, choice);
      if (view === source || !store) continue;
      if (JSON.stringify(keysIn(store)) === JSON.stringify(keys)) continue;
      view.data(choice + "_store", keys.map((key) => (
        { unit: "", fields: [{ type: "E", field: fields[choice] }], values: [key] }))).runAsync();
    }
    const row = markRows(choice, keys);
    if (told) tell(row);
  };

  const fit = (view, element) => {
    const svg = element.querySelector("svg");
    if (!svg || !element.clientWidth) return;
    const { columns } = specs[element.dataset.chart];
    if (columns) {
      const now = view.signal("child_width");
      // What axes and gaps take is known before the first change, which is drawn later.
      view.beside ??= svg.width.baseVal.value - columns * now;
      const side = Math.max(120, Math.min(360, (element.clientWidth - view.beside) / columns));
      if (Math.abs(side - now) >= 1) view.signal("child_width", side).resize().runAsync();
      return;
    }
    // What axes take: a legend that is wider than the chart would count as theirs.
    view.around = Math.min(view.around ?? Infinity, svg.width.baseVal.value - view.width());
    const { around } = view;
    const ratio = Number(element.dataset.ratio);
    const wide = Math.max(120, Math.min(ratio ? 620 : 720, element.clientWidth - around));
    if (Math.abs(wide - view.width()) < 1) return;
    view.width(wide);
    if (ratio) view.height(wide / ratio);
    view.runAsync();
  };

  const draw = async (element) => {
    const spec = specs[element.dataset.chart];
    if (element.clientWidth < 480) {
      if (spec.columns) spec.columns = 1;
      spec.config.legend.columns = 3;
    }
    const { view } = await window.termselEmbed(element, spec, {
      ast: true, actions: false, renderer: "svg", defaultStyle: false, mode: "vega-lite",
      tooltip: { disableDefaultStyle: true } });
    views.push(view);
    for (const choice of Object.keys(fields)) {
      if (!storeOf(view, choice)) continue;
      view.addDataListener(choice + "_store", (_, store) => choose(choice, keysIn(store), view));
    }
    fit(view, element);
    new ResizeObserver(() => fit(view, element)).observe(element);
  };

  document.addEventListener("click", (event) => {
    const row = event.target.closest("table[data-choice] tbody tr");
    if (!row) return;
    const key = JSON.parse(row.dataset.key);
    const choice = row.closest("table").dataset.choice;
    choose(choice, row.classList.contains("chosen") && choice !== "member" ? [] : [key], null);
  });

  const all = [...document.querySelectorAll(".chart")].map(draw);
  Promise.all(all).then(() => {
    for (const view of views) {
      const store = storeOf(view, "member");
      if (store && store.length) choose("member", keysIn(store), view, false);
    }
    document.documentElement.dataset.drawn = String(views.length);
  });
})();
