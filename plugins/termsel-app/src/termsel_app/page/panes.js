// @ts-check
/** Image and map: two panes of OpenLayers, with all that is drawn in them. */

const ol = /** @type {any} */ (window).ol;

/** @typedef {[number, number]} Place */

export const ROLE_COLOURS = {
  "": "#0072b2", control: "#0072b2", check: "#e08a00", independent: "#6b3fa0", off: "#7c858f",
};
const BLUNDER = "#d1003f";
const NEXT = "#00805a";
const PREDICTED = "#e5007a";
const HALO = "#ffffff";
/** Pixels of the screen of the longest arrow. */
const LONGEST_ARROW = 46;
/** Pixels of the screen within which a click hits a feature, or is snapped to one. */
const NEAR = 9;

/** A pane: its map, the layers of its features, and its loupe. */
export class Pane {
  /**
   * @param {{name: string, extent: number[], box: number[], resolutions: number[], origin: Place,
   *   sources: any[], flat: boolean, projection: any}} given
   */
  constructor(given) {
    this.name = given.name;
    this.projection = given.projection;
    this.box = given.box;
    this.sources = given.sources;
    this.control = new ol.source.Vector();
    this.guides = new ol.source.Vector();
    this.drawn = new ol.source.Vector();
    this.predicted = new ol.source.Vector();
    this.proposed = new ol.source.Vector();
    /** @type {any[]} */
    this.base = given.sources.map(source => new ol.layer.Tile({ source, maxTilesLoading: 8 }));
    // Names give way to one another; what marks a place never does.
    this.controlLayer = new ol.layer.Vector({ source: this.control, style: styleOf, zIndex: 9, declutter: true,
      updateWhileAnimating: true, updateWhileInteracting: true });
    const finest = given.resolutions[given.resolutions.length - 1];
    this.view = new ol.View({
      projection: this.projection, center: middle(given.box), constrainOnlyCenter: true,
      minResolution: finest / (given.flat ? 32 : 8), maxResolution: given.resolutions[0] * 8,
      smoothExtentConstraint: true, enableRotation: false,
    });
    this.map = new ol.Map({
      target: given.name, view: this.view, maxTilesLoading: 16,
      controls: [new ol.control.Zoom()],
      layers: [
        ...this.base,
        new ol.layer.Vector({ source: this.drawn, style: drawnStyle, zIndex: 5, declutter: true }),
        new ol.layer.Vector({ source: this.guides, style: guideStyle, zIndex: 8 }),
        this.controlLayer,
        new ol.layer.Vector({ source: this.proposed, style: predictedStyle, zIndex: 10 }),
        new ol.layer.Vector({ source: this.predicted, style: predictedStyle, zIndex: 10 }),
      ],
    });
    this.fit();
    this.loupe = new ol.Map({
      target: `${given.name}-loupe`, controls: [], interactions: [],
      layers: this.sources.map(source => new ol.layer.Tile({ source })),
      view: new ol.View({ projection: this.projection, center: [0, 0], resolution: 1,
        constrainResolution: false, enableRotation: false }),
    });
  }

  /** Show all. */
  fit() {
    this.view.fit(this.box, { size: this.map.getSize(), padding: [24, 28, 24, 24] });
  }

  /**
   * Go to a place, so near that a ring of a size can be judged.
   * @param {Place} place
   * @param {number} [width] of what is to be seen
   */
  goTo(place, width) {
    const size = this.map.getSize() ?? [400, 400];
    let resolution = this.view.getResolution();
    if (width) resolution = Math.min(resolution, Math.max(width / (size[0] * 0.35), this.view.getMinResolution()));
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
      this.view.setCenter(place);
      this.view.setResolution(resolution);
    } else {
      this.view.animate({ center: place, resolution, duration: 250 });
    }
  }

  /**
   * Show a place enlarged, or nothing.
   * @param {Place | null} place
   */
  magnify(place) {
    const element = this.loupe.getTargetElement();
    element.classList.toggle("on", place !== null);
    if (place === null) return;
    this.loupe.getView().setCenter(place);
    this.loupe.getView().setResolution(this.view.getResolution() / 4);
  }

  /**
   * Return the feature of the control at a position on the screen.
   * @param {number[]} position
   * @returns {any}
   */
  at(position) {
    return this.map.forEachFeatureAtPixel(position, feature => feature, {
      hitTolerance: NEAR, layerFilter: layer => layer === this.controlLayer,
    });
  }

  /**
   * Return a place, or the vertex or edge of a layer that is near it on the screen.
   * @param {Place} place
   * @param {any[]} layers
   * @returns {Place}
   */
  snapped(place, layers) {
    const reach = NEAR * this.view.getResolution();
    let best = place;
    let least = reach;
    for (const source of layers) {
      source.forEachFeatureInExtent(ol.extent.buffer([...place, ...place], reach), feature => {
        const geometry = feature.getGeometry();
        const edge = geometry.getClosestPoint(place);
        const distance = Math.hypot(edge[0] - place[0], edge[1] - place[1]);
        const vertex = nearestVertex(geometry, place, reach);
        if (vertex && vertex.distance / 2 < least) {
          least = vertex.distance / 2; // a vertex says more than an edge
          best = vertex.place;
        } else if (distance < least) {
          least = distance;
          best = edge.slice(0, 2);
        }
      });
    }
    return best;
  }
}

/**
 * @param {any} geometry
 * @param {Place} place
 * @param {number} reach
 * @returns {{place: Place, distance: number} | null}
 */
function nearestVertex(geometry, place, reach) {
  const parts = geometry.getGeometries ? geometry.getGeometries() : [geometry];
  let best = null;
  for (const part of parts) {
    const flat = part.getFlatCoordinates();
    const stride = part.getStride();
    for (let i = 0; i < flat.length; i += stride) {
      const distance = Math.hypot(flat[i] - place[0], flat[i + 1] - place[1]);
      if (distance < reach && (!best || distance < best.distance)) {
        best = { place: /** @type {Place} */ ([flat[i], flat[i + 1]]), distance };
      }
    }
  }
  return best;
}

/** @param {number[]} box @returns {Place} */
export function middle(box) {
  return [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
}

/**
 * A source of tiles of this server.
 * @param {any} projection
 * @param {string} address
 * @param {Place} origin
 * @param {number[]} resolutions
 * @param {number[]} extent
 */
export function tiles(projection, address, origin, resolutions, extent) {
  return new ol.source.TileImage({
    projection, interpolate: false, transition: 0, url: address, wrapX: false,
    tileGrid: new ol.tilegrid.TileGrid({ origin, resolutions, extent, tileSize: 256 }),
  });
}

/**
 * A source of tiles of a IIIF server.
 * @param {any} projection
 * @param {any} info its description
 * @param {number[]} extent
 */
export function served(projection, info, extent) {
  const options = new ol.format.IIIFInfo(info).getTileSourceOptions();
  if (!options) throw new Error("the description of the IIIF image cannot be read");
  return new ol.source.IIIF({ ...options, projection, extent, interpolate: false, transition: 0 });
}

/**
 * The styles of a feature of the control.
 * @param {any} feature
 * @param {number} resolution
 */
function styleOf(feature, resolution) {
  const { record, chosen, error, largest, blunder, arrows, unused } = feature.getProperties();
  const colour = blunder ? BLUNDER : ROLE_COLOURS[record.role] ?? ROLE_COLOURS[""];
  if (record.kind === "line") return lineStyles(feature, colour, chosen, unused || record.role === "off", record.id);
  const whole = record.image && record.map;
  const styles = [];
  if (arrows && error && error.line !== null && largest > 0) {
    const start = feature.getGeometry().getCoordinates();
    const scale = (LONGEST_ARROW * resolution) / largest;
    // From where the point was measured to where the model sees it; lines run down the screen.
    styles.push(...arrow(start, [start[0] - error.sample * scale, start[1] + error.line * scale],
      colour));
  }
  if (chosen) {
    styles.push(new ol.style.Style({ image: new ol.style.Circle({ declutterMode: "none",
      radius: 13, stroke: new ol.style.Stroke({ color: PREDICTED, width: 2 }) }) }));
  }
  if (blunder) {
    styles.push(new ol.style.Style({ image: new ol.style.Circle({ declutterMode: "none",
      radius: 10, stroke: new ol.style.Stroke({ color: BLUNDER, width: 2.5 }) }) }));
  }
  styles.push(
    new ol.style.Style({ image: cross(HALO, 4) }),
    new ol.style.Style({
      image: cross(colour, 2),
      text: new ol.style.Text({
        text: record.id, offsetX: 9, offsetY: -9, textAlign: "left",
        font: `${chosen ? "700" : "600"} 12px system-ui, sans-serif`,
        fill: new ol.style.Fill({ color: whole ? colour : PREDICTED }),
        stroke: new ol.style.Stroke({ color: HALO, width: 3.5 }),
      }),
    }),
    new ol.style.Style({ image: new ol.style.Circle({ declutterMode: "none",
      radius: 5, fill: record.role === "off" ? undefined : new ol.style.Fill({ color: `${colour}55` }),
      stroke: new ol.style.Stroke({ color: whole ? colour : PREDICTED, width: 1.6,
        lineDash: whole ? undefined : [3, 3] }) }) }),
  );
  return styles;
}

/** @param {string} color @param {number} width */
function cross(color, width) {
  return new ol.style.RegularShape({ declutterMode: "none", points: 4, radius: 9, radius2: 0, angle: 0,
    stroke: new ol.style.Stroke({ color, width }) });
}

/** @param {Place} start @param {Place} end @param {string} color */
function arrow(start, end, color) {
  const turn = Math.atan2(end[1] - start[1], end[0] - start[0]);
  const shaft = new ol.geom.LineString([start, end]);
  return [
    new ol.style.Style({ geometry: shaft, stroke: new ol.style.Stroke({ color: HALO, width: 4.5 }) }),
    new ol.style.Style({ geometry: shaft, stroke: new ol.style.Stroke({ color, width: 2.2 }) }),
    new ol.style.Style({ geometry: new ol.geom.Point(end), image: new ol.style.RegularShape({ declutterMode: "none",
      points: 3, radius: 6, rotation: Math.PI / 2 - turn, rotateWithView: true,
      fill: new ol.style.Fill({ color }), stroke: new ol.style.Stroke({ color: HALO, width: 1 }) }) }),
  ];
}

/** @param {any} feature @param {string} color @param {boolean} chosen @param {boolean} unused @param {string} name */
function lineStyles(feature, color, chosen, unused, name) {
  const ends = feature.getGeometry().getCoordinates();
  const label = new ol.style.Text({ text: name, offsetY: -10, font: "600 12px system-ui, sans-serif",
    fill: new ol.style.Fill({ color }), stroke: new ol.style.Stroke({ color: HALO, width: 3.5 }) });
  return [
    new ol.style.Style({ stroke: new ol.style.Stroke({ color: HALO, width: 6 }) }),
    new ol.style.Style({ stroke: new ol.style.Stroke({ color: chosen ? PREDICTED : color, width: 3,
      lineDash: unused ? [6, 5] : undefined }), text: label }),
    ...ends.map(end => new ol.style.Style({ geometry: new ol.geom.Point(end),
      image: new ol.style.Circle({ radius: 4, fill: new ol.style.Fill({ color: HALO }),
        stroke: new ol.style.Stroke({ color, width: 2 }) }) })),
  ];
}

/** Places to measure next. @param {any} feature */
function guideStyle(feature) {
  return new ol.style.Style({
    image: new ol.style.RegularShape({ declutterMode: "none", points: 4, radius: 11, angle: 0,
      fill: new ol.style.Fill({ color: "#ffffffe0" }), stroke: new ol.style.Stroke({ color: NEXT, width: 2.2 }) }),
    text: new ol.style.Text({ text: feature.get("label"), font: "700 11px system-ui, sans-serif",
      fill: new ol.style.Fill({ color: NEXT }) }),
  });
}

/** Vectors and graticules. @param {any} feature */
function drawnStyle(feature) {
  const label = feature.get("label");
  const color = label ? "#0a6b7d" : "#d95f02";
  return [
    new ol.style.Style({ stroke: new ol.style.Stroke({ color: "#ffffffb0", width: label ? 2.5 : 3.5 }) }),
    new ol.style.Style({
      stroke: new ol.style.Stroke({ color, width: label ? 1 : 1.6 }),
      image: new ol.style.Circle({ radius: 3, fill: new ol.style.Fill({ color }) }),
      text: label && new ol.style.Text({ text: label, placement: "line", font: "11px system-ui, sans-serif",
        fill: new ol.style.Fill({ color }), stroke: new ol.style.Stroke({ color: HALO, width: 3 }) }),
    }),
  ];
}

/** Where a place of the other pane is. @param {any} feature */
function predictedStyle(feature) {
  if (feature.getGeometry().getType() === "Polygon") {
    return [
      new ol.style.Style({ stroke: new ol.style.Stroke({ color: "#ffffffc0", width: 4 }) }),
      new ol.style.Style({ stroke: new ol.style.Stroke({ color: PREDICTED, width: 1.8 }),
        fill: new ol.style.Fill({ color: "#e5007a18" }) }),
    ];
  }
  return [new ol.style.Style({ image: cross(HALO, 4) }), new ol.style.Style({ image: cross(PREDICTED, 1.8) })];
}

/**
 * Show where a place of the other pane is predicted, or nothing.
 * @param {Pane} pane
 * @param {{place: Place, ring: Place[]} | null} prediction
 */
export function showPrediction(pane, prediction) {
  pane.predicted.clear(true);
  if (!prediction) return;
  const features = [new ol.Feature(new ol.geom.Point(prediction.place))];
  if (prediction.ring.length) features.push(new ol.Feature(new ol.geom.Polygon([prediction.ring])));
  pane.predicted.addFeatures(features);
}

/**
 * Show the control in a pane.
 * @param {Pane} pane
 * @param {any[]} records
 * @param {(record: any) => Place[]} placesOf
 * @param {(record: any) => object} detailsOf
 */
export function showControl(pane, records, placesOf, detailsOf) {
  const features = [];
  for (const record of records) {
    const places = placesOf(record);
    if (!places.length) continue;
    const geometry = record.kind === "point" ? new ol.geom.Point(places[0])
      : new ol.geom.LineString(places.length === 1 ? [places[0], places[0]] : places);
    const feature = new ol.Feature({ geometry, record, ...detailsOf(record) });
    feature.setId(record.id);
    features.push(feature);
  }
  pane.control.clear(true);
  pane.control.addFeatures(features);
}

/**
 * Draw lines in a pane, with labels or without.
 * @param {Pane} pane
 * @param {{label?: string, places: Place[]}[]} lines
 */
export function drawLines(pane, lines) {
  pane.drawn.clear(true);
  pane.drawn.addFeatures(lines.filter(line => line.places.length > 1).map(line => new ol.Feature({
    geometry: new ol.geom.LineString(line.places), label: line.label })));
}

/**
 * Mark the places to measure next.
 * @param {Pane} pane
 * @param {Place[]} places
 */
export function showNext(pane, places) {
  pane.guides.clear(true);
  pane.guides.addFeatures(places.map((place, i) => new ol.Feature({
    geometry: new ol.geom.Point(place), label: String(i + 1) })));
}

/**
 * Show the points that matching proposes.
 * @param {Pane} pane
 * @param {Place[]} places
 */
export function showProposals(pane, places) {
  pane.proposed.clear(true);
  pane.proposed.addFeatures(places.map(place => new ol.Feature(new ol.geom.Point(place))));
}

/**
 * Let features of the control be dragged.
 * @param {Pane} pane
 * @param {(id: string, places: Place[]) => void} dropped
 */
export function letDrag(pane, dropped) {
  const translate = new ol.interaction.Translate({ layers: [pane.controlLayer], hitTolerance: NEAR - 2 });
  translate.on("translateend", event => {
    const feature = event.features.item(0);
    if (!feature) return;
    const [start, end] = [event.startCoordinate, event.coordinate];
    if (Math.hypot(start[0] - end[0], start[1] - end[1]) < 2 * pane.view.getResolution()) return;
    const coordinates = feature.getGeometry().getCoordinates();
    dropped(feature.getId(), feature.get("record").kind === "point" ? [coordinates] : coordinates);
  });
  pane.map.addInteraction(translate);
}

/**
 * A layer that shows a grid of numbers over a box, as an image.
 * @param {any} projection
 * @param {{box: number[], side: number, values: (number | null)[]}} grid top, left, bottom, right
 */
export function gridLayer(projection, grid) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = grid.side;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const pixels = context.createImageData(grid.side, grid.side);
  const { low, high } = limits(grid.values);
  grid.values.forEach((value, i) => {
    const colour = value === null ? [0, 0, 0, 0] : [...ramp((value - low) / (high - low || 1)), 255];
    pixels.data.set(colour, 4 * i);
  });
  context.putImageData(pixels, 0, 0);
  const [top, left, bottom, right] = grid.box;
  return new ol.layer.Image({ opacity: 0.55, zIndex: 3, source: new ol.source.ImageStatic({
    url: canvas.toDataURL(), projection, imageExtent: [left, -bottom, right, -top], interpolate: true }) });
}

/** @param {(number | null)[]} values */
export function limits(values) {
  const known = /** @type {number[]} */ (values.filter(value => value !== null));
  return { low: Math.min(...known), high: Math.max(...known) };
}

const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

/** Colours from dark, where little is uncertain, to bright. @param {number} share @returns {number[]} */
export function ramp(share) {
  const at = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
  const i = Math.min(Math.floor(at), STOPS.length - 2);
  return STOPS[i].map((low, band) => Math.round(low + (at - i) * (STOPS[i + 1][band] - low)));
}
