/* results.csv as a table: sorted by its heads, filtered by what its rows are about. */

const KEYS = ["scene", "method", "variant", "split", "component", "metric", "budget", "device"];
const ALWAYS = ["scene", "method", "metric"];
const FIRST_ROWS = 200;
/** Columns whose words are short differ from those that may be long. */
const HEADS = {value: "Value", interval: "Interval", n: "n", seeds: "Seeds", published: "Value"};
const EXPLAINED = {
  interval: "95 % interval of the mean; of a time its 95th percentile (p95)",
  n: "test images, or repetitions of the whole measurement",
};

function resultsSection(report) {
  const {words, at} = report.results;
  const count = report.results.value.length;
  const keys = KEYS.filter(key => ALWAYS.includes(key) ? words[key].length > 0 : words[key].length > 1);
  const hasPublished = report.results.published.some(value => value !== null);
  const hasIntervals = report.results.hi.some(value => value !== null);
  const measured = ["value", ...hasIntervals ? ["interval"] : [], "n", ...report.results.seeds.some(s => s > 1) ? ["seeds"] : []];
  const columns = measured.length + (hasIntervals ? 1 : 0);  // the interval is drawn as well
  const state = {chosen: {}, sort: null, falling: false, all: false};
  const word = (key, row) => words[key][at[key][row]];

  // ---- filters: each says how many rows are left under the others
  const filters = new Map(keys.filter(key => words[key].length > 1).map(key =>
    [key, choice(key[0].toUpperCase() + key.slice(1), [["", ""], ...words[key].map((text, i) => [String(i), text])],
      "", value => { state.chosen[key] = value; state.all = false; render(); })]));
  const clear = button("Clear", () => {
    state.chosen = {};
    for (const {select} of filters.values()) select.value = "";
    render();
  }, {class: "plain"});

  function matches(row, but) {
    return keys.every(key => key === but || !state.chosen[key] || at[key][row] === Number(state.chosen[key]));
  }

  function countOptions() {
    for (const [key, {select}] of filters) {
      const left = new Array(words[key].length).fill(0);
      for (let row = 0; row < count; row++) if (matches(row, key)) left[at[key][row]]++;
      select.options[0].textContent = `all ${words[key].length}`;
      words[key].forEach((text, i) => {
        const option = select.options[i + 1];
        option.textContent = `${key === "metric" ? optionName(text) : text || "(none)"} · ${left[i]}`;
        option.disabled = !left[i] && state.chosen[key] !== String(i);
      });
    }
    clear.hidden = !Object.values(state.chosen).some(Boolean);
  }

  function optionName(name) {
    const metric = report.metrics[name];
    return metric?.label && metric.label !== name ? `${name} (${metric.label})` : name;
  }

  // ---- sorting: rising, falling, as in the file
  function sortBy(name) {
    if (state.sort !== name) Object.assign(state, {sort: name, falling: false});
    else if (!state.falling) state.falling = true;
    else Object.assign(state, {sort: null, falling: false});
    render();
  }

  function sorted(rows) {
    const name = state.sort;
    if (!name) return rows;
    const way = state.falling ? -1 : 1;
    if (keys.includes(name)) {
      const rank = words[name].map((_, i) => i).sort((a, b) => words[name][a].localeCompare(words[name][b], "en", {numeric: true}));
      const place = rank.reduce((all, word, i) => { all[word] = i; return all; }, []);
      return rows.sort((a, b) => way * (place[at[name][a]] - place[at[name][b]]) || a - b);
    }
    const of = name === "interval" ? row => num(report.results.hi[row]) - num(report.results.lo[row])
      : row => num(report.results[name][row]);
    const known = rows.filter(row => !Number.isNaN(of(row))), rest = rows.filter(row => Number.isNaN(of(row)));
    return [...known.sort((a, b) => way * (of(a) - of(b)) || a - b), ...rest];  // what is not known is last
  }

  // ---- the table
  const heads = new Map([...keys, ...measured, ...hasPublished ? ["published"] : []].map(name => [name, headOf(name)]));
  function headOf(name) {
    const isKey = keys.includes(name);
    const label = HEADS[name] ?? name[0].toUpperCase() + name.slice(1);
    return el("th" + (isKey ? "" : ".figure") + (name === "published" ? ".published" : "") + (name === "value" ? ".edge" : ""),
      {scope: "col", "data-column": name, "aria-sort": "none"},
      button([label, el("span.way", {"aria-hidden": "true"})], () => sortBy(name), {class: "sort", title: EXPLAINED[name]}));
  }
  const drawn = hasIntervals ? el("th", {scope: "col"}, el("span.sr", "Interval drawn")) : null;
  const headRow = el("tr", keys.map(key => heads.get(key)),
    measured.map(name => [heads.get(name), name === "value" ? drawn : null]),
    hasPublished ? heads.get("published") : null);
  const body = el("tbody");
  const more = button("", () => { state.all = true; render(); }, {class: "more"});
  const status = el("p.small.status", {role: "status"});

  function render() {
    countOptions();
    const rows = sorted(Array.from({length: count}, (_, row) => row).filter(row => matches(row)));
    const shown = state.all ? rows : rows.slice(0, FIRST_ROWS);
    const scales = scalesOf(rows);
    fill(body, shown.map(row => rowOf(row, scales)));
    for (const [name, head] of heads)
      head.setAttribute("aria-sort", state.sort !== name ? "none" : state.falling ? "descending" : "ascending");
    status.textContent = (shown.length < rows.length ? `Showing the first ${shown.length} of ` : "Showing ")
      + plural(rows.length, "row") + (rows.length < count ? ` of ${count.toLocaleString("en")}` : "");
    more.textContent = `Show all ${rows.length.toLocaleString("en")} rows`;
    more.hidden = shown.length === rows.length;
  }

  /** Intervals share a scale where they are of one metric and component. */
  function scalesOf(rows) {
    const groups = new Map();
    const {value, lo, hi} = report.results;
    for (const row of rows) {
      const group = groupOf(row);
      if (!groups.has(group)) groups.set(group, []);
      groups.get(group).push([value[row], lo[row], hi[row]]);
    }
    return new Map([...groups].map(([group, ends]) => [group, scaleOf(ends)]));
  }

  function groupOf(row) {
    return `${at.metric[row]} ${at.component[row]}`;
  }

  function rowOf(row, scales) {
    const {value, lo, hi, n, seeds, published} = report.results;
    const name = word("metric", row), metric = report.metrics[name];
    const cells = {
      value: () => [el("td.figure.value.edge", n[row] === null ? NONE : value[row] === null ? NOT_AVAILABLE : figure(value[row], metric)),
        hasIntervals ? el("td", strip(value[row], lo[row], hi[row], scales.get(groupOf(row)))) : null],
      interval: () => el("td.figure.interval", interval(lo[row], hi[row], metric)),
      n: () => el("td.figure", n[row] === null ? NONE : n[row]),
      seeds: () => el("td.figure", seeds[row] === null ? NONE : seeds[row]),
    };
    return el("tr", keys.map(key => key === "metric"
      ? el("td.metric", {title: metric?.label !== name ? metric?.label : null}, name,
        el("span.unit", ` ${[metric?.unit, ARROWS[metric?.better]].filter(Boolean).join(" ")}`))
      : key === "scene" ? el("th", {scope: "row"}, word(key, row)) : el(`td.${key}`, word(key, row) || el("span.nothing", NONE))),
    measured.map(name => cells[name]()),
    hasPublished ? el("td.figure.published", figure(published[row], metric)) : null);
  }

  render();
  const same = KEYS.filter(key => !keys.includes(key) && words[key].length === 1 && words[key][0])
    .map(key => `${key} ${words[key][0]}`);
  return [
    same.length ? el("p.explain", `Of all rows: ${same.join("; ")}.`) : null,
    el("div.filters", {role: "group", "aria-label": "Rows shown"}, [...filters.values()].map(one => one.node), clear, status),
    scroller("All rows of results.csv", el("table.results",
      el("colgroup", {span: keys.length}), el("colgroup", {span: columns}),
      hasPublished ? el("colgroup.published", {span: "1"}) : null,
      el("thead", el("tr.owners", el("td", {colspan: keys.length}),
        el("th.edge", {scope: "colgroup", colspan: columns}, "Measured by this project"),
        hasPublished ? el("th.published", {scope: "colgroup"}, "Published") : null), headRow),
      body)),
    more,
    hasPublished ? el("p.explain", "Published figures are of the paper's own scenes, renderer and machine: only the ",
      "order of methods can be compared with the measured ones.") : null,
  ];
}
