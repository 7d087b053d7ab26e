/* Intervals drawn: a bar from end to end, a dot at the value, on a scale that the rows beside it share. */

/** The scale that holds all of [lo, value, hi], with `zero` in it where that is asked for. */
function scaleOf(rows, zero = false) {
  const ends = rows.flat().map(num).filter(Number.isFinite);
  if (zero) ends.push(0);
  if (!ends.length) return null;
  const low = Math.min(...ends), high = Math.max(...ends);
  const room = (high - low || Math.abs(high) || 1) * 0.04;
  const from = low - room, span = high - low + 2 * room;
  return {at: value => `${(100 * (value - from) / span).toFixed(2)}%`, share: v => `${(100 * v / span).toFixed(2)}%`};
}

/** One interval; `kind` colours it. */
function strip(value, lo, hi, scale, {zero = false, kind = ""} = {}) {
  const middle = num(value);
  const node = el("div.strip" + (kind ? `.${kind}` : ""), {"aria-hidden": "true"});
  if (!scale || !Number.isFinite(middle)) return node;
  if (zero) node.append(placed("i.zero", {left: scale.at(0)}));
  const from = lo === null ? middle : num(lo), to = num(hi);
  if (Number.isFinite(from) && Number.isFinite(to) && to >= from)
    node.append(placed("i.bar", {left: scale.at(from), width: scale.share(to - from)}));
  node.append(placed("i.dot", {left: scale.at(middle)}));
  return node;
}

function placed(spec, style) {
  const node = el(spec);
  Object.assign(node.style, style);
  return node;
}

/** A block for every claim, in the colour of its verdict. */
function verdictBlocks(counts) {
  return el("div.blocks", {"aria-hidden": "true"}, Object.keys(VERDICTS).flatMap(name =>
    Array.from({length: counts[name] ?? 0}, () => el(`i.${name}`))));
}
