"use strict";
// Round numbers of an axis from low to high, as `ticks` of `loadid/_page/chart.py`: for charts of pages and of the lab.

const ticks = (low, high, log, most) => {
  const found = [];
  if (log) {
    const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9);
    if (last - first >= 1) {
      const step = Math.max(1, Math.ceil((last - first + 1) / most));
      for (let k = first; k <= last; k += step) found.push(Number(`1e${k}`));
      return found;
    }
    for (let k = first - 2; k < last + 2; k++) for (const m of [1, 2, 5]) {
      const value = m * 10 ** k;
      if (low <= value && value <= high) found.push(value);
    }
    return found.length > 1 ? found : ticks(low, high, false, most);
  }
  const size = 10 ** Math.floor(Math.log10((high - low) / most));
  let step = [1, 2, 5, 10].map(m => m * size).find(s => (high - low) / s <= most) ?? 10 * size;
  if (Math.floor(high / step) <= Math.ceil(low / step)) step /= 2;  // one number tells no scale
  const last = Math.floor(high / step + 1e-9);
  for (let k = Math.ceil(low / step - 1e-9); k <= last && found.length < 40; k++) found.push(Number((k * step).toPrecision(12)));
  return found;
};

