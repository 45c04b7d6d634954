// Charts of a page: read off, zoom, save. What is drawn follows `loadid/_page/chart.py`: ticks, margins, extremes.

const written = value => {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e3 && size < 1e5) return value.toFixed(0);
  const text = size >= 1e-3 && size < 1e5 ? String(Number(value.toPrecision(4))) : value.toExponential(3);
  const [head, power] = text.split("e");
  return power === undefined ? text : `${Number(head)}e${Number(power)}`;
};

const share = (value, [low, high], log) => log
  ? (value > 0 ? Math.log(value / low) / Math.log(high / low) : NaN) : (value - low) / (high - low);
const place = (part, [low, high], log) => log ? low * (high / low) ** part : low + part * (high - low);

const unpacked = (text, Kind) => new Kind(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
const opened = chart => {
  for (const curve of chart.curves) {
    const x = curve.x;
    curve.x = typeof x === "string" ? unpacked(x, Float64Array)
      : Float64Array.from({ length: x[2] }, (_, i) => x[0] + i * x[1]);
    for (const key of ["y", "low", "high"]) if (curve[key]) curve[key] = unpacked(curve[key], curve.wide ? Float64Array : Float32Array);
  }
  return chart;
};

// first and one past the last sample in view, one more on each side
const around = (x, [low, high], room = 1) => {
  const search = (value, past) => {
    let a = 0, b = x.length;
    while (a < b) { const m = (a + b) >> 1; if (past ? x[m] <= value : x[m] < value) a = m + 1; else b = m; }
    return a;
  };
  return [Math.max(search(low, false) - room, 0), Math.min(search(high, true) + room, x.length)];
};

const height = (chart, view) => {
  if (chart.range && view[0] <= chart.whole[0] && view[1] >= chart.whole[1]) return chart.range;
  let low = Infinity, high = -Infinity;
  for (const curve of chart.curves) for (const key of ["y", "low", "high"]) {
    const part = curve[key] ?? [], [a, b] = curve.dots ? [0, part.length] : around(curve.x, view);
    for (let i = a; i < Math.min(b, part.length); i++) {
      const value = part[i];
      if (curve.dots && (curve.x[i] < view[0] || curve.x[i] > view[1])) continue;
      if (!Number.isFinite(value) || chart.yLog && value <= 0) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (low > high) return chart.yLog ? [0.1, 1] : [-1, 1];
  if (chart.yLog) { const room = Math.max((high / low) ** 0.05, 1.1); return [low / room, high * room]; }
  const room = 0.05 * (high - low) || 0.5 * Math.abs(high) || 1;
  return [low - room, high + room];
};

// path through [x, y] in units of the drawing: of every column the first, the lowest, the highest and the last
const path = (chart, curve, key, view, ends, columns) => {
  const [a, b] = curve.dots ? [0, curve.x.length] : around(curve.x, view), y = curve[key], thin = b - a > 4 * columns;
  let text = "", pen = false, column = -1, low, high, last;
  const put = (u, v) => {
    if (!Number.isFinite(u) || !Number.isFinite(v)) { pen = false; return; }
    text += `${pen ? " " : text ? "h0M" : "M"}${Math.round(2000 * u)} ${Math.round(1000 * (1 - Math.min(Math.max(v, -1), 2)))}`;
    pen = true;
  };
  const flush = () => { if (column >= 0) for (const one of [low, high, last]) put(...one); };
  for (let i = a; i < b; i++) {
    const u = share(curve.x[i], view, chart.xLog), v = share(y[i], ends, chart.yLog);
    if (!thin) { put(u, v); continue; }
    const at = Math.floor(Math.min(Math.max(u, 0), 1) * columns);
    if (at !== column) { flush(); column = at; low = high = last = [u, v]; put(u, v); continue; }
    if (v < low[1]) low = [u, v];
    if (v > high[1]) high = [u, v];
    last = [u, v];
  }
  if (thin) flush();
  return text && text + "h0";
};

const band = (chart, curve, view, ends, columns) => {
  const up = [], down = [], [a, b] = around(curve.x, view), floor = chart.yLog ? ends[0] : -Infinity;
  for (let i = a; i < b; i++) {
    if (!Number.isFinite(curve.low[i]) || !Number.isFinite(curve.high[i])) continue;
    const u = share(curve.x[i], view, chart.xLog), at = Math.floor(Math.min(Math.max(u, 0), 1) * columns);
    const low = share(Math.max(curve.low[i], floor), ends, chart.yLog), high = share(curve.high[i], ends, chart.yLog);
    const before = up[up.length - 1];
    if (b - a > 2 * columns && before && before.at === at) {
      before.v = Math.max(before.v, high);
      down[down.length - 1].v = Math.min(down[down.length - 1].v, low);
    } else { up.push({ at, i, u, v: high }); down.push({ at, i, u, v: low }); }
  }
  const said = one => `${Math.round(2000 * one.u)} ${Math.round(1000 * (1 - Math.min(Math.max(one.v, -1), 2)))}`;
  const pieces = [];
  let from = 0;
  for (let k = 1; k <= up.length; k++) {
    if (k < up.length && gapless(curve, up[k - 1].i, up[k].i)) continue;
    pieces.push("M" + [...up.slice(from, k), ...down.slice(from, k).reverse()].map(said).join(" ") + "z");
    from = k;
  }
  return up.length ? pieces.join("") : "";
};
const gapless = (curve, i, j) => {
  for (let k = i + 1; k < j; k++) if (!Number.isFinite(curve.low[k])) return false;
  return true;
};

const nearest = (x, value) => {
  let best = 0;
  for (let i = 1; i < x.length; i++) if (Math.abs(x[i] - value) < Math.abs(x[best] - value)) best = i;
  return best;
};

// a table of what is in view: one row for each place, cells that would be a formula elsewhere are quoted as text
const table = (chart, view) => {
  const cell = text => {
    const safe = /^[=+\-@\t\r]/.test(text) && Number.isNaN(Number(text)) ? `'${text}` : text;
    return /[",\n\r]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
  };
  const heads = [chart.xName], rows = new Map();
  let width = 1;
  for (const curve of chart.curves) {
    const keys = ["y", "low", "high"].filter(key => curve[key]), [a, b] = around(curve.x, view, 0);
    for (const key of keys) heads.push(curve.name + (key === "y" ? "" : `, ${key === "low" ? "lower" : "upper"} end of the band`));
    for (let i = curve.dots ? 0 : a; i < (curve.dots ? curve.x.length : b); i++) {
      if (curve.x[i] < view[0] || curve.x[i] > view[1]) continue;
      const name = chart.every > 1 ? `${curve.x[i]}|${i}` : curve.x[i], row = rows.get(name) ?? [curve.x[i]];
      keys.forEach((key, k) => { row[width + k] = curve[key][i]; });
      rows.set(name, row);
    }
    width += keys.length;
  }
  const said = (value, k) => value === undefined || Number.isNaN(value) ? ""
    : k === 0 && chart.names.length ? chart.names[Math.round(value)] ?? "" : String(Number(value.toPrecision(k ? 7 : 12)));
  const lines = [...rows.values()].sort((p, q) => p[0] - q[0])
    .map(row => Array.from({ length: width }, (_, k) => cell(said(row[k], k))).join(","));
  return [heads.map(cell).join(","), ...lines].join("\r\n") + "\r\n";
};

// -- the page ---------------------------------------------------------------------------------------------------------
const SVG = "http://www.w3.org/2000/svg";
const made = (name, attributes, text) => {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  return node;
};
const percent = part => `${(100 * part).toFixed(2)}%`;

const live = figure => {
  const chart = JSON.parse(figure.dataset.chart), plot = figure.querySelector(".plot"), strip = figure.querySelector(".strip");
  const whole = chart.whole, first = chart.window ?? whole;
  let view = first, ends = null, ready = false, cursor = null, drag = null;
  const prepare = () => { if (!ready) { opened(chart); ends = height(chart, view); ready = true; } };
  const group = name => plot.querySelector(`.${name}`);

  const draw = () => {
    prepare();
    ends = height(chart, view);
    const { width } = plot.getBoundingClientRect();
    const columns = Math.max(200, Math.min(Math.round(width), 2000)), curves = group("curves"), dots = group("dots");
    const ticksX = chart.names.length ? chart.names.map((_, i) => i).filter(i => i % Math.ceil(chart.names.length / 8) === 0 && i >= view[0] && i <= view[1])
      : ticks(...view, chart.xLog, Math.max(3, Math.min(7, Math.floor(width / 80))));
    const ticksY = ticks(...ends, chart.yLog, 8);
    const atX = v => percent(share(v, view, chart.xLog)), atY = v => percent(1 - share(v, ends, chart.yLog));
    group("grid").replaceChildren(
      ...ticksX.map(v => made("line", { x1: atX(v), x2: atX(v), y1: "0", y2: "100%" })),
      ...ticksY.map(v => made("line", { x1: "0", x2: "100%", y1: atY(v), y2: atY(v) })),
      ...!chart.yLog && ends[0] < 0 && ends[1] > 0 ? [made("line", { class: "zero", x1: "0", x2: "100%", y1: atY(0), y2: atY(0) })] : []);
    const word = v => { const name = chart.names[v]; return name === undefined ? written(v) : name.length > 14 ? name.slice(0, 13) + "…" : name; };
    group("ticks").replaceChildren(
      ...ticksX.map(v => made("text", { x: atX(v), y: "100%", dy: 17, "text-anchor": "middle" }, word(v))),
      ...ticksY.map(v => made("text", { x: 0, dx: -7, y: atY(v), dy: 4, "text-anchor": "end" }, written(v))));
    group("shades").replaceChildren(...chart.shades.map(pair => pair.map(v => Math.min(Math.max(share(v, view, chart.xLog), 0), 1)))
      .filter(([a, b]) => b > a).map(([a, b]) => made("rect", { class: "shade", x: percent(a), width: percent(b - a), y: 0, height: "100%" })));
    const inside = v => v >= view[0] && v <= view[1];
    const left = v => share(v, view, chart.xLog) > 0.8;
    group("lines").replaceChildren(...chart.lines.filter(([v]) => inside(v)).flatMap(([v, name], k) => [
      made("line", { x1: atX(v), x2: atX(v), y1: "0", y2: "100%" }), made("text", { x: atX(v), y: 0, dx: left(v) ? -3 : 3, dy: 11 + 13 * (k % 6), "text-anchor": left(v) ? "end" : "start" }, name)]));
    curves.replaceChildren(); dots.replaceChildren();
    for (const curve of chart.curves) if (curve.low && !curve.dots) {
      curves.append(made("path", { class: `band ${curve.look}`, d: band(chart, curve, view, ends, columns) }));
    }
    for (const curve of chart.curves) {
      if (!curve.dots) curves.append(made("path", { class: `curve ${curve.look}`, d: path(chart, curve, "y", view, ends, columns) }));
      const [a, b] = curve.dots ? [0, curve.x.length] : around(curve.x, view, 0);
      if (!curve.dots && b - a > 60) continue;
      for (let i = a; i < b; i++) {
        const v = share(curve.y[i], ends, chart.yLog);
        if (!inside(curve.x[i]) || !(v > -0.01 && v < 1.01)) continue;
        if (curve.low && curve.dots) dots.append(made("line", { class: `bar ${curve.look}`, x1: atX(curve.x[i]), x2: atX(curve.x[i]), y1: atY(curve.low[i]), y2: atY(curve.high[i]) }));
        dots.append(made("circle", { class: `dot ${curve.look}${curve.dots ? "" : " small"}`, cx: atX(curve.x[i]), cy: percent(1 - v), r: 3 }));
      }
    }
    if (brush) { const [a, b] = view.map(v => share(v, whole, chart.xLog)); brush.setAttribute("x", percent(a)); brush.setAttribute("width", percent(b - a)); }
    point();
  };

  const brush = strip && strip.querySelector(".brush");
  const line = made("line", { class: "reading", y1: "0", y2: "100%", visibility: "hidden" });
  const chosen = made("rect", { class: "chosen", y: 0, height: "100%", visibility: "hidden" });
  plot.append(chosen, line);
  const tools = document.createElement("div"), said = document.createElement("output");
  tools.className = "tools"; said.className = "readout"; said.setAttribute("aria-live", "polite");

  const point = () => {
    if (cursor === null || cursor < view[0] || cursor > view[1]) { line.setAttribute("visibility", "hidden"); said.textContent = ""; return; }
    const main = chart.curves[0], [a, b] = main.dots ? [0, main.x.length] : around(main.x, view, 0);
    const seen = b > a ? main.x.subarray(a, b) : main.x, at = seen[nearest(seen, cursor)], name = chart.names[at];
    line.setAttribute("visibility", "visible");
    for (const key of ["x1", "x2"]) line.setAttribute(key, percent(share(at, view, chart.xLog)));
    const values = chart.curves.map(curve => {
      const i = nearest(curve.x, at);
      if (!Number.isFinite(curve.y[i]) || curve.dots && curve.x[i] !== at && chart.curves.length > 1) return null;
      return `${curve.name} ${written(curve.y[i])}` + (curve.low ? ` (${written(curve.low[i])} to ${written(curve.high[i])})` : "");
    }).filter(Boolean);
    said.textContent = `${chart.xName}: ${name ?? written(at)} · ${values.join(" · ")}`;
  };
  const to = ([a, b]) => {
    a = Math.max(a, whole[0]); b = Math.min(b, whole[1]);
    if (b - a > 1e-9 * (whole[1] - whole[0])) { view = [a, b]; draw(); }
  };
  const zoom = (factor, middle = 0.5) => to([place(middle - middle * factor, view, chart.xLog), place(middle + (1 - middle) * factor, view, chart.xLog)]);
  const slide = part => {
    const [a, b] = [place(part, view, chart.xLog), place(1 + part, view, chart.xLog)];
    if (a >= whole[0] && b <= whole[1]) to([a, b]);
  };
  const where = (node, event) => {
    const box = node.getBoundingClientRect(), look = getComputedStyle(node), left = parseFloat(look.paddingLeft), right = parseFloat(look.paddingRight);
    return Math.min(Math.max((event.clientX - box.left - left) / (box.width - left - right), 0), 1);
  };

  // -- hand and keys
  plot.addEventListener("pointermove", event => {
    prepare();
    const at = where(plot, event);
    cursor = place(at, view, chart.xLog);
    if (drag !== null && Math.abs(at - drag) > 0.005) {
      chosen.setAttribute("visibility", "visible");
      chosen.setAttribute("x", percent(Math.min(at, drag))); chosen.setAttribute("width", percent(Math.abs(at - drag)));
    }
    point();
  });
  plot.addEventListener("pointerdown", event => {
    if (event.pointerType !== "mouse" || event.button !== 0) return;
    drag = where(plot, event); plot.setPointerCapture(event.pointerId);
  });
  plot.addEventListener("pointerup", event => {
    if (drag === null) return;
    const [a, b] = [drag, where(plot, event)].sort((p, q) => p - q);
    drag = null; chosen.setAttribute("visibility", "hidden");
    if (b - a > 0.01) to([place(a, view, chart.xLog), place(b, view, chart.xLog)]);
  });
  plot.addEventListener("pointerleave", () => { if (drag === null) { cursor = null; point(); } });
  plot.addEventListener("dblclick", () => to(whole));
  plot.addEventListener("wheel", event => {
    if (!event.ctrlKey) return;
    event.preventDefault(); zoom(event.deltaY < 0 ? 0.8 : 1.25, where(plot, event));
  }, { passive: false });
  plot.addEventListener("keydown", event => {
    prepare();
    const main = chart.curves[0].x, step = event.key === "ArrowLeft" ? -1 : 1;
    if (event.key.startsWith("Arrow") && (event.key === "ArrowLeft" || event.key === "ArrowRight")) {
      if (event.shiftKey) slide(0.2 * step);
      else {
        const from = cursor === null || cursor < view[0] || cursor > view[1] ? nearest(main, place(0.5, view, chart.xLog)) : nearest(main, cursor);
        cursor = main[Math.min(Math.max(from + step, 0), main.length - 1)];
        point();
      }
    } else if (event.key === "+" || event.key === "=") zoom(0.5);
    else if (event.key === "-") zoom(2);
    else if (event.key === "Home" || event.key === "0") to(whole);
    else if (event.key === "Escape") { cursor = null; to(first); }
    else return;
    event.preventDefault();
  });
  if (strip) {
    let from = null;
    const move = event => {
      const at = where(strip, event);
      if (Math.abs(at - from) > 0.002) to([from, at].sort((p, q) => p - q).map(v => place(v, whole, chart.xLog)));
    };
    strip.addEventListener("pointerdown", event => { from = where(strip, event); strip.setPointerCapture(event.pointerId); });
    strip.addEventListener("pointermove", event => { if (from !== null) move(event); });
    strip.addEventListener("pointerup", event => {
      if (Math.abs(where(strip, event) - from) <= 0.002) {  // a tap brings the part that is shown there
        const half = (share(view[1], whole, chart.xLog) - share(view[0], whole, chart.xLog)) / 2, at = Math.min(Math.max(from, half), 1 - half);
        to([at - half, at + half].map(v => place(v, whole, chart.xLog)));
      }
      from = null;
    });
    strip.classList.add("live");
  }

  // -- what is shown, as a file
  const name = (chart.title.replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-+|-+$/g, "") || "chart").slice(0, 60);
  const save = (blob, suffix) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob); link.download = `${name}.${suffix}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  const alone = () => {
    prepare();
    const look = getComputedStyle(plot), [top, right, bottom, left] = ["Top", "Right", "Bottom", "Left"].map(s => parseFloat(look[`padding${s}`]));
    const { width: W, height: H } = plot.getBoundingClientRect(), head = 46;
    const out = made("svg", { xmlns: SVG, width: W, height: H + head + 34, viewBox: `0 0 ${W} ${H + head + 34}`, "font-family": "sans-serif", "font-size": 12 });
    const paper = getComputedStyle(figure.closest(".loadid")).backgroundColor;
    const ink = getComputedStyle(figure).color;
    out.append(made("rect", { width: "100%", height: "100%", fill: paper }));
    out.append(made("text", { x: 8, y: 16, "font-weight": "bold", fill: ink }, chart.title));
    out.append(made("text", { x: 8, y: 34, fill: ink }, `${chart.yName} — ${chart.curves.map(c => c.name).join(", ")}`));
    out.append(made("text", { x: W - right, y: H + head + 10, "text-anchor": "end", fill: ink }, chart.xName));
    const note = figure.closest(".loadid").dataset.note;
    if (note) out.append(made("text", { x: 8, y: H + head + 27, fill: ink, "font-size": 10 }, note));
    const inner = made("svg", { x: left, y: head + top, width: W - left - right, height: H - top - bottom, overflow: "visible" });
    const copy = (from, into) => {
      for (const child of from.children) {
        if (child === line || child === chosen) continue;
        const node = child.cloneNode(false), style = getComputedStyle(child);
        node.removeAttribute("class");
        for (const key of ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "vector-effect", "r"]) {
          const value = style.getPropertyValue(key);
          if (value && value !== "auto" && (key !== "r" || child.tagName === "circle")) node.setAttribute(key, value);
        }
        if (child.tagName === "text") node.textContent = child.textContent; else copy(child, node);
        into.append(node);
      }
    };
    copy(plot, inner);
    out.append(inner);
    return [new XMLSerializer().serializeToString(out), W, H + head + 34];
  };
  const picture = () => {
    const [text, W, H] = alone(), image = new Image(), link = URL.createObjectURL(new Blob([text], { type: "image/svg+xml" }));
    image.onload = () => {
      const canvas = document.createElement("canvas");
      canvas.width = 2 * W; canvas.height = 2 * H;
      canvas.getContext("2d").drawImage(image, 0, 0, 2 * W, 2 * H);
      URL.revokeObjectURL(link);
      canvas.toBlob(blob => save(blob, "png"));
    };
    image.src = link;
  };
  const button = (text, title, act) => {
    const node = document.createElement("button");
    node.type = "button"; node.textContent = text; node.title = title; node.setAttribute("aria-label", `${title}: ${chart.title}`);
    node.addEventListener("click", act); tools.append(node);
  };
  button("+", "zoom in", () => zoom(0.5));
  button("−", "zoom out", () => zoom(2));
  button("whole", "show the whole axis", () => to(whole));
  if (chart.window) button("peak", "show what is around the peak", () => to(first));
  button("SVG", "save this view as a drawing", () => save(new Blob([alone()[0]], { type: "image/svg+xml" }), "svg"));
  button("PNG", "save this view as a picture", picture);
  button("CSV", chart.every > 1 ? `save the numbers in view, the extremes of every ${chart.every} samples` : "save the numbers in view",
    () => { prepare(); save(new Blob([table(chart, view)], { type: "text/csv" }), "csv"); });
  tools.append(said);
  figure.append(tools);
  plot.classList.add("live");
};

if (typeof document !== "undefined") {
  for (const figure of document.querySelectorAll("figure.chart")) {
    try { live(figure); } catch (error) { console.error(error); }  // it stays the picture that it is
  }
  let shut = [];
  addEventListener("beforeprint", () => {
    shut = [...document.querySelectorAll("details:not([open])")];
    for (const part of shut) part.open = true;
  });
  addEventListener("afterprint", () => { for (const part of shut) part.open = false; });
}
