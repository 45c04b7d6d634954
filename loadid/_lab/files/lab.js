// What all pages of the lab share: calls, controls, readouts, plots and maps in SVG. Nothing here computes a result:
// the numbers come from the package, this draws them.

const token = document.querySelector("meta[name=lab-token]").content;
const page = document.body.dataset.page;
document.getElementById("old")?.remove();
const SVG = "http://www.w3.org/2000/svg";

// -- calls ------------------------------------------------------------------------------------------------------------
const faults = new Map();  // of each kind of work, until it succeeds
const fault = (work, text) => {
  const place = document.getElementById("fault");
  faults.set(work, text);
  place.textContent = [...new Set(faults.values())].filter(Boolean).join("; ");
  place.hidden = !place.textContent;
};

// said at the edge of the page while the server takes more than a moment
let open = 0, patience = 0;
const working = by => {
  open += by;
  const place = document.getElementById("working");
  if (!open) { clearTimeout(patience); place.textContent = ""; }
  else if (by > 0 && open === 1) patience = setTimeout(() => { place.textContent = "computing …"; }, 300);
};

const answered = async (address, options, quietly = false) => {
  let found;
  if (!quietly) working(1);
  try {
    found = await fetch(address, { method: "POST", cache: "no-store", ...options });
  } catch {
    throw new Error("the server does not answer: has it been ended?");
  } finally {
    if (!quietly) working(-1);
  }
  const json = (found.headers.get("Content-Type") ?? "").startsWith("application/json");
  if (!found.ok) throw new Error(json ? (await found.json()).error : `the server said ${found.status}`);
  return json ? found.json() : { blob: await found.blob(), name: /filename="([^"]*)"/.exec(found.headers.get("Content-Disposition") ?? "")?.[1] };
};

// ask a call of this page; an Error with a sentence where it is refused. Quietly: nobody waits for the answer
export const ask = (call, parameters = {}, quietly = false) => answered(`/${page}/${call}`, {
  headers: { "Content-Type": "application/json", "X-Lab-Token": token }, body: JSON.stringify(parameters) }, quietly);

// send a File to a call that takes an upload
export const upload = (call, file, parameters = {}) => answered(`/${page}/${call}`, {
  headers: { "Content-Type": "application/octet-stream", "X-Lab-Token": token, "X-Lab-File": encodeURIComponent(file.name),
    "X-Lab-Parameters": encodeURIComponent(JSON.stringify(parameters)) }, body: file });

// let the browser save what a call answered as a Download
export const save = ({ blob, name }) => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name ?? "download";
  link.click();
  URL.revokeObjectURL(link.href);
};

// one piece of work at a time: of the requests that come while one runs, only the last is done. `work` may be async.
// The number of pictures drawn stands in data-drawn of the page, for who measures.
let drawn = 0;
export const latest = work => {
  let running = false, waiting = null;
  return async (...given) => {
    waiting = given;
    if (running) return;
    running = true;
    while (waiting) {
      const now = waiting;
      waiting = null;
      try { await work(...now); fault(work, ""); } catch (error) { fault(work, error.message); }
      document.documentElement.dataset.drawn = ++drawn;
    }
    running = false;
  };
};

// -- controls ---------------------------------------------------------------------------------------------------------
export const written = (value, digits = 3) => {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e-3 && size < 1e5 ? String(Number(value.toPrecision(digits))) : value.toExponential(digits - 1).replace(/\.?0+e/, "e");
  return text.replace("e+", "e").replace(/^-/, "−").replace("e-", "e−");
};
// a rule of the package by the name that texts give it
const RULES = { upre: "UPRE", gcv: "GCV", robust_gcv: "robust GCV", modified_gcv: "modified GCV", l_curve: "L-curve",
  ncp: "NCP", quasi_optimality: "quasi-optimality" };
export const ruled = rule => RULES[rule] ?? rule.replaceAll("_", " ");
export const percent = (value, digits = 1) => value === null ? "–" : `${written(100 * value, digits + 2)} %`;

// what a control stands for; a slider that was set keeps the value, between its steps, until it is moved
const valueOf = input => input.type === "checkbox" ? input.checked
  : input.dataset.exact !== undefined ? Number(input.dataset.exact)
  : input.type !== "range" ? input.value : input.dataset.log === undefined ? Number(input.value)
  : Number((10 ** Number(input.value)).toPrecision(6));

const tell = input => {
  if (input.type !== "range") return;
  const text = written(valueOf(input)) + (input.dataset.unit ? ` ${input.dataset.unit}` : "");
  input.setAttribute("aria-valuetext", text);
  const output = input.closest(".control")?.querySelector("output");
  if (output) output.textContent = text;
};

// The named inputs of a form as an object, and what changes them. A range with data-log stands for 10 ** value; its
// <output> in the same .control shows the value. `changed` is called at every input with the values.
export const controls = (form, changed) => {
  const inputs = [...form.elements].filter(e => e.name && e.tagName !== "FIELDSET" && e.type !== "button");
  const values = () => Object.fromEntries(inputs.filter(i => i.type !== "radio" || i.checked).map(i => [i.name, valueOf(i)]));
  const set = given => {
    for (const [name, value] of Object.entries(given)) for (const input of inputs.filter(i => i.name === name)) {
      if (input.type === "checkbox") input.checked = value;
      else if (input.type === "radio") input.checked = input.value === String(value);
      else input.value = input.dataset.log === undefined ? value : Math.log10(value);
      if (input.type === "range") input.dataset.exact = value;
      tell(input);
    }
  };
  inputs.forEach(tell);
  form.addEventListener("submit", event => event.preventDefault());
  form.addEventListener("input", event => { delete event.target.dataset.exact; tell(event.target); changed(values(), event.target.name); });
  return { values, set };
};

// numbers beside a picture: <dl class="numbers"> from [[name, text, look?], ...]; look is true for a loud one, or a class
export const readouts = (place, rows) => {
  place.replaceChildren(...rows.map(([name, text, look]) => {
    const box = document.createElement("div"), dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = name; dd.textContent = text; box.className = look === true ? "loud" : look || "";
    box.append(dt, dd);
    return box;
  }));
};

// what a screen reader hears of a picture: said when nothing has changed for a moment
const waits = new Map();
export const announce = (place, text) => {
  clearTimeout(waits.get(place));
  waits.set(place, setTimeout(() => { if (place.textContent !== text) place.textContent = text; }, 400));
};

// -- plots ------------------------------------------------------------------------------------------------------------
export const SHAPES = {
  circle: "M5 0A5 5 0 1 1-5 0A5 5 0 1 1 5 0Z", square: "M-4.5-4.5H4.5V4.5H-4.5Z", triangle: "M0-6L5.5 4.5H-5.5Z",
  diamond: "M0-6.5L5 0L0 6.5L-5 0Z", down: "M0 6L5.5-4.5H-5.5Z", plus: "M-6 0H6M0-6V6", cross: "M-4.5-4.5L4.5 4.5M-4.5 4.5L4.5-4.5",
  target: "M5 0A5 5 0 1 1-5 0A5 5 0 1 1 5 0ZM-8 0H8M0-8V8",
  star: "M0-7L1.8-2.2L7-2.2L2.8 1L4.4 6L0 3L-4.4 6L-2.8 1L-7-2.2L-1.8-2.2Z",
};
export const node = (name, given = {}, ...inner) => {
  const one = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(given)) one.setAttribute(key, value);
  one.append(...inner);
  return one;
};

const ends = (axis, series, keys) => {
  if (axis.low !== undefined && axis.high !== undefined) return [axis.low, axis.high];
  let low = Infinity, high = -Infinity;
  for (const one of series) for (const key of keys) for (const value of one[key] ?? []) {
    if (value === null || !Number.isFinite(value) || axis.log && value <= 0) continue;
    low = Math.min(low, value); high = Math.max(high, value);
  }
  if (low > high) [low, high] = axis.log ? [0.1, 1] : [0, 1];
  if (axis.log) { const room = Math.max((high / low) ** 0.05, 1.1); low /= room; high *= room; }
  else { const room = 0.05 * (high - low) || 0.5 * Math.abs(high) || 1; low -= room; high += room; }
  return [axis.low ?? low, axis.high ?? high];
};

// A picture in a <figure class="plot">, which is emptied:
//   {title, said, height, x: {label, low, high, log, ticks}, y: {...}, series: [...], uprights: [{x, name, look}], pick}
// series: {kind, x, y, name, look} with kind "line" (default), "steps", "stems", "dots", "bars" (y from 0; `width` in x),
// or "band" (y, y2). look is a class of the style: truth, estimate, measured, naive, level, used, other0 ... other5, each
// with its own dash; dots take a `shape` of SHAPES. pick(x, y) is called with the place of a click, for pointers: give the
// keyboard a slider for it. What leaves a y axis that is fixed is said below the picture.
const drawings = new Map();
const draw = (figure, plot) => {
  const { x, y, series } = plot, width = Math.max(figure.clientWidth, 200), height = plot.height ?? 260;
  const pad = { left: 58, right: 14, top: 10, bottom: 40 }, w = width - pad.left - pad.right, h = height - pad.top - pad.bottom;
  const [x0, x1] = ends(x, series, ["x"]), [y0, y1] = ends(y, series, ["y", "y2"]);
  const at = (value, low, high, log) => log ? (value > 0 ? Math.log(value / low) / Math.log(high / low) : -1) : (value - low) / (high - low);
  const px = value => pad.left + w * at(value, x0, x1, x.log);
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const py = value => pad.top + h * (1 - clamp(at(value, y0, y1, y.log), -4, 5));
  const round = value => Math.round(value * 10) / 10;
  const good = (one, i) => one.x[i] !== null && one.y[i] !== null && Number.isFinite(one.x[i]) && Number.isFinite(one.y[i]);
  const name = plot.title ?? "";
  const svg = node("svg", { height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": plot.said ?? name });
  const id = `clip-${figure.id || Math.random().toString(36).slice(2)}`;
  svg.append(node("defs", {}, node("clipPath", { id }, node("rect", { x: pad.left, y: pad.top, width: w, height: h }))));
  const grid = node("g", { class: "grid" }), text = node("g", { class: "ticks" });
  for (const value of x.ticks ?? ticks(x0, x1, x.log, Math.max(2, Math.floor(w / 62)))) {
    grid.append(node("line", { x1: px(value), x2: px(value), y1: pad.top, y2: pad.top + h }));
    text.append(node("text", { x: px(value), y: pad.top + h + 16, "text-anchor": "middle" }, written(value)));
  }
  for (const value of y.ticks ?? ticks(y0, y1, y.log, Math.max(2, Math.floor(h / 34)))) {
    grid.append(node("line", { x1: pad.left, x2: pad.left + w, y1: py(value), y2: py(value), class: value === 0 ? "zero" : "" }));
    text.append(node("text", { x: pad.left - 7, y: py(value) + 4, "text-anchor": "end" }, written(value)));
  }
  const inside = node("g", { "clip-path": `url(#${id})` });
  let top = null, bottom = null;
  const base = py(y.log ? y0 : clamp(0, y0, y1));
  for (const one of series) {
    const kind = one.kind ?? "line", look = one.look ?? "", n = Math.min(one.x.length, one.y.length);
    if (y.low !== undefined && kind !== "band") for (const value of one.y)
      if (value !== null && value > y1) top = Math.max(top ?? value, value);
      else if (value !== null && value < y0 && !(y.log && value <= 0)) bottom = Math.min(bottom ?? value, value);
    if (kind === "band") {
      const up = [], down = [];
      for (let i = 0; i < n; i++) if (good(one, i) && one.y2[i] !== null) {
        up.push(`${round(px(one.x[i]))} ${round(py(one.y2[i]))}`);
        down.push(`${round(px(one.x[i]))} ${round(py(one.y[i]))}`);
      }
      if (up.length) inside.append(node("path", { class: `band ${look}`, d: `M${[...up, ...down.reverse()].join("L")}Z` }));
    } else if (kind === "dots" || kind === "stems") {
      for (let i = 0; i < n; i++) {
        if (!good(one, i)) continue;
        const u = round(px(one.x[i])), v = round(py(one.y[i]));
        if (kind === "stems") inside.append(node("line", { class: `bar ${look}`, x1: u, x2: u, y1: base, y2: v }));
        inside.append(node("path", { class: `mark ${look}`, transform: `translate(${u} ${v}) scale(${one.size ?? 0.7})`, d: SHAPES[one.shape ?? "circle"] }));
      }
    } else if (kind === "bars") {
      for (let i = 0; i < n; i++) if (good(one, i)) {
        const a = px(one.x[i] - one.width / 2), b = px(one.x[i] + one.width / 2), v = py(one.y[i]);
        const [u0, u1] = x.log ? [px(one.x[i] / one.width ** 0.5), px(one.x[i] * one.width ** 0.5)] : [a, b];
        inside.append(node("rect", { class: `block ${look}`, x: round(u0), width: round(Math.max(u1 - u0, 1)), y: round(Math.min(v, base)), height: round(Math.abs(base - v)) }));
      }
    } else {
      let d = "", pen = false, before = 0;
      for (let i = 0; i < n; i++) {
        if (!good(one, i)) { pen = false; continue; }
        const u = round(px(one.x[i])), v = round(py(one.y[i]));
        d += pen ? (kind === "steps" ? `H${round((u + before) / 2)}V${v}H${u}` : `L${u} ${v}`) : `M${u} ${v}`;
        pen = true; before = u;
      }
      if (d) inside.append(node("path", { class: `curve ${look}`, d }));
    }
  }
  // names of uprights stand below each other from left to right, each with a dot on its line
  const uprights = (plot.uprights ?? []).filter(one => one.x !== null && one.x !== undefined).sort((a, b) => a.x - b.x);
  uprights.forEach((one, k) => {
    const u = px(one.x), v = pad.top + 12 + 15 * (k % 8), long = 8 + 7 * (one.name ?? "").length;
    const flip = u + long > pad.left + w || (2 * k + 1 < uprights.length && u - long > pad.left);
    inside.append(node("line", { class: `upright ${one.look ?? ""}`, x1: u, x2: u, y1: pad.top, y2: pad.top + h }),
      node("circle", { class: `upright ${one.look ?? ""} dot`, cx: u, cy: v - 4, r: 3 }));
    inside.append(node("text", { x: u + (flip ? -8 : 8), y: v, "text-anchor": flip ? "end" : "start" }, one.name ?? ""));
  });
  svg.append(grid, inside, node("rect", { class: "frame", x: pad.left, y: pad.top, width: w, height: h }), text,
    node("text", { x: pad.left + w, y: height - 6, "text-anchor": "end" }, x.label ?? ""));
  if (plot.pick) {
    svg.classList.add("pick");
    svg.addEventListener("pointerdown", event => {
      const box = svg.getBoundingClientRect(), u = (event.clientX - box.left - pad.left) / w, v = 1 - (event.clientY - box.top - pad.top) / h;
      if (u < 0 || u > 1 || v < 0 || v > 1) return;
      const back = (part, low, high, log) => log ? low * (high / low) ** part : low + part * (high - low);
      plot.pick(back(u, x0, x1, x.log), back(v, y0, y1, y.log), { px, py, u: u * w + pad.left, v: (1 - v) * h + pad.top });
    });
  }
  const caption = document.createElement("figcaption"), key = document.createElement("span");
  const title = document.createElement("b"), axis = document.createElement("p"), note = document.createElement("p");
  title.textContent = name; key.className = "key"; axis.className = "axis"; axis.textContent = y.label ?? "";
  for (const one of series) if (one.name) key.append(keyed(one));
  caption.append(title, key);
  note.className = "note";
  const reached = [[top, "largest"], [bottom, "smallest"]].filter(([value]) => value !== null).map(([value, name]) => `its ${name} value is ${written(value)}`);
  note.textContent = reached.length && !plot.silent ? `The curve leaves the picture: ${reached.join(", ")}.` : "";
  figure.replaceChildren(caption, axis, svg, ...(y.low !== undefined && !plot.silent ? [note] : []));
};
const keyed = one => {
  const item = document.createElement("span"), kind = one.kind ?? "line", look = one.look ?? "";
  const swatch = node("svg", { class: "swatch", width: 26, height: 14, "aria-hidden": "true", viewBox: "0 0 26 14" });
  if (kind === "band") swatch.append(node("rect", { class: `band ${look}`, width: 26, height: 14 }));
  else if (kind === "bars") swatch.append(node("rect", { class: `block ${look}`, x: 6, y: 1, width: 14, height: 12 }));
  else if (kind === "dots" || kind === "stems") swatch.append(node("path", { class: `mark ${look}`, transform: "translate(13 7) scale(.8)", d: SHAPES[one.shape ?? "circle"] }));
  else swatch.append(node("path", { class: `curve ${look}`, d: "M0 7H26" }));
  item.append(swatch, one.name);
  return item;
};
const watch = new ResizeObserver(entries => {
  for (const { target, contentRect } of entries) {
    const last = drawings.get(target);
    if (last && Math.abs(last.width - contentRect.width) > 1) { last.width = contentRect.width; last.again(); }
  }
});
const kept = (figure, again) => {
  if (!drawings.has(figure)) watch.observe(figure);
  drawings.set(figure, { width: figure.clientWidth, again });
};
export const plot = (figure, given) => {
  draw(figure, given);
  kept(figure, () => draw(figure, given));
};

// -- maps -------------------------------------------------------------------------------------------------------------
// A map of values on a grid in a <figure class="plot map">, row 0 at the bottom:
//   {title, said, values: [rows][columns], low, high, unit, x: [low, high], y: [low, high], label_x, label_y, signed,
//    arrows: [{x, y, u, v}], scale, dots: [{x, y}], shape, outline: [[x, y], ...]}
// Light is small, dark is large, its ends and its largest value (with a cross) are written: colour carries nothing alone.
const shade = (part, signed) => {
  const mix = (a, b, t) => a.map((one, k) => Math.round(one + (b[k] - one) * t));
  if (signed) return part < 0 ? mix([247, 247, 247], [179, 71, 0], Math.min(-part, 1)) : mix([247, 247, 247], [0, 84, 140], Math.min(part, 1));
  const stops = [[250, 250, 250], [158, 202, 225], [33, 113, 181], [8, 29, 88]], t = Math.min(Math.max(part, 0), 1) * 3;
  return mix(stops[Math.min(Math.floor(t), 2)], stops[Math.min(Math.floor(t), 2) + 1], t - Math.min(Math.floor(t), 2));
};
const drawMap = (figure, given) => {
  const { values, signed } = given, rows = values.length, columns = values[0].length, flat = values.flat().filter(v => v !== null);
  const high = given.high ?? Math.max(...flat, 1e-300), low = given.low ?? (signed ? -high : Math.min(...flat, 0));
  const [x0, x1] = given.x ?? [0, columns], [y0, y1] = given.y ?? [0, rows];
  const pad = { left: 48, right: 10, top: 6, bottom: 36 }, width = Math.max(figure.clientWidth, 200);
  const w = width - pad.left - pad.right, h = Math.min(w * (y1 - y0) / (x1 - x0), given.height ?? 420), height = h + pad.top + pad.bottom;
  const canvas = document.createElement("canvas");
  canvas.width = columns; canvas.height = rows;
  const context = canvas.getContext("2d"), image = context.createImageData(columns, rows);
  let top = -Infinity, peak = [0, 0];
  for (let i = 0; i < rows; i++) for (let j = 0; j < columns; j++) {
    const value = values[i][j], k = 4 * ((rows - 1 - i) * columns + j);
    if (value !== null && value > top) { top = value; peak = [i, j]; }
    const colour = value === null ? [128, 128, 128] : shade(signed ? value / Math.max(high, -low) : (value - low) / (high - low || 1), signed);
    image.data.set([...colour, 255], k);
  }
  context.putImageData(image, 0, 0);
  const px = x => pad.left + w * (x - x0) / (x1 - x0), py = y => pad.top + h * (1 - (y - y0) / (y1 - y0));
  const svg = node("svg", { height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": given.said ?? given.title ?? "" });
  svg.append(node("image", { href: canvas.toDataURL(), x: pad.left, y: pad.top, width: w, height: h, preserveAspectRatio: "none" }));
  for (const value of ticks(x0, x1, false, Math.max(2, w / 62))) svg.append(node("text", { x: px(value), y: pad.top + h + 15, "text-anchor": "middle" }, written(value)));
  for (const value of ticks(y0, y1, false, Math.max(2, h / 40))) svg.append(node("text", { x: pad.left - 6, y: py(value) + 4, "text-anchor": "end" }, written(value)));
  for (const { x, y, u, v } of given.arrows ?? []) {
    const s = given.scale ?? 1, a = px(x), b = py(y), c = px(x + s * u), d = py(y + s * v), size = Math.hypot(c - a, d - b);
    if (size < 1.5) continue;
    const e = [(c - a) / size, (d - b) / size], t = Math.min(5, size / 2);
    svg.append(node("path", { class: "arrow", d: `M${a} ${b}L${c} ${d}M${c - t * (e[0] - 0.6 * e[1])} ${d - t * (e[1] + 0.6 * e[0])}L${c} ${d}L${c - t * (e[0] + 0.6 * e[1])} ${d - t * (e[1] - 0.6 * e[0])}` }));
  }
  for (const { x, y } of given.dots ?? []) svg.append(node("path", { class: "mark", transform: `translate(${px(x)} ${py(y)}) scale(.4)`, d: SHAPES[given.shape ?? "circle"] }));
  if (given.outline) svg.append(node("path", { class: "curve truth", d: `M${given.outline.map(([x, y]) => `${px(x)} ${py(y)}`).join("L")}Z` }));
  svg.append(node("path", { class: "mark", transform: `translate(${px(x0 + (peak[1] + 0.5) * (x1 - x0) / columns)} ${py(y0 + (peak[0] + 0.5) * (y1 - y0) / rows)})`, d: SHAPES.cross }),
    node("rect", { class: "frame", x: pad.left, y: pad.top, width: w, height: h }),
    node("text", { x: pad.left + w, y: height - 4, "text-anchor": "end" }, given.label_x ?? ""));
  const caption = document.createElement("figcaption"), title = document.createElement("b"), range = document.createElement("span"), axis = document.createElement("p");
  title.textContent = given.title ?? "";
  axis.className = "axis"; axis.textContent = given.label_y ?? "";
  range.textContent = `light ${written(signed ? 0 : low)} to dark ${written(high)} ${given.unit ?? ""}; × marks the largest, ${written(top)}`;
  caption.append(title, range);
  figure.replaceChildren(caption, axis, svg);
};
export const map = (figure, given) => { drawMap(figure, given); kept(figure, () => drawMap(figure, given)); };
