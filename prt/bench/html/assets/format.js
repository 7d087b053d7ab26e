/* Numbers and names as people read them. */

const NONE = "–", NOT_AVAILABLE = "n/a";
/** Sign, word of one claim, word of several. */
const VERDICTS = {holds: ["✔", "holds", "hold"], fails: ["✘", "fails", "fail"], undecided: ["?", "undecided", "undecided"]};
const ARROWS = {higher: "↑", lower: "↓"};
const THIN = "\u202f";

/** A figure of the data as a number: what JSON does not have comes as a sign. */
function num(value) {
  return value === "∞" ? Infinity : value === "-∞" ? -Infinity : value === null ? NaN : value;
}

/** Three significant digits, plain as long as that can be read. */
function digits(value, count = 3) {
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) return value.toExponential(count - 1).replace("e+", "e");
  const shown = Number(value.toPrecision(count));
  return shown.toLocaleString("en", {maximumSignificantDigits: Math.max(count, 3), useGrouping: size >= 1e4});
}

/** `value` in the largest of the units [factor, name] that it fills. */
function scaled(value, units) {
  const size = Math.abs(value);
  const [factor, name] = units.find(([least]) => size >= least) ?? units[units.length - 1];
  return digits(value / factor) + THIN + name;
}

const TIMES = [[1, "s"], [1e-3, "ms"], [1e-6, "µs"]];
const SIZES = [[1e9, "GB"], [1e6, "MB"], [1e3, "kB"], [1, "B"]];

/** A figure of a metric in its own form. */
function figure(value, metric) {
  const number = num(value);
  if (Number.isNaN(number)) return NONE;
  if (!Number.isFinite(number)) return String(value);
  if (metric?.form === "time") return number === 0 ? "0" : scaled(number, TIMES);
  if (metric?.form === "bytes") return number === 0 ? "0" : scaled(number, SIZES);
  return metric?.form === "2" || metric?.form === "4" ? number.toFixed(Number(metric.form)) : digits(number);
}

/** `[lo, hi]`; where only an upper end is known it is a time's 95th percentile. */
function interval(lo, hi, metric) {
  if (hi === null) return "";
  return lo === null ? `p95 ${figure(hi, metric)}` : `[${figure(lo, metric)}, ${figure(hi, metric)}]`;
}

/** `PSNR`, with its unit and the arrow that points where better is. */
function metricName(metric, name) {
  if (!metric) return name;
  const unit = [metric.unit, ARROWS[metric.better]].filter(Boolean).join(" ");
  return [metric.label || name, unit && el("span.unit", ` ${unit}`)];
}

/** `Raghavan 2023` of the folder `raghavan2023`. */
function paperName(paper) {
  if (!paper) return "Others";
  const spaced = paper.replace(/[_-]+/g, " ").replace(/([a-z])(\d{4})/gi, "$1 $2");
  return spaced.charAt(0).toUpperCase() + spaced.slice(1);
}

function tableName(name) {
  return name.slice(name.lastIndexOf("/") + 1);
}

function plural(count, one, many = one + "s") {
  return `${count.toLocaleString("en")} ${count === 1 ? one : many}`;
}

/** A verdict in a word, a sign and a colour. */
function verdict(name, count) {
  const [sign, word, words] = VERDICTS[name] ?? ["?", name, name];
  return el(`span.verdict.${VERDICTS[name] ? name : "undecided"}`,
    el("span.sign", {"aria-hidden": "true"}, sign), count === undefined ? word : `${count} ${count === 1 ? word : words}`);
}
