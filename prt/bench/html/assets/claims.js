/* Claims with their verdicts, filtered by them; each opens into its scenes. */

function claimsSection(report) {
  const counts = {};
  for (const claim of report.claims) counts[claim.verdict] = (counts[claim.verdict] ?? 0) + 1;
  const shown = {verdict: "", open: false};
  const rows = report.claims.map((claim, i) => claimRows(report, claim, i));
  const status = el("p.small.status", {role: "status"});
  const table = el("table.claims",
    el("thead", el("tr", el("th", {scope: "col"}, "Verdict"), el("th", {scope: "col"}, "Claim"),
      el("th", {scope: "col"}, "Scenes"))), rows.map(row => row.body));
  const filters = ["", ...Object.keys(VERDICTS).filter(name => counts[name])].map(name =>
    button(name ? verdict(name, counts[name]) : `All ${report.claims.length}`, () => show(name),
      {class: "filter", "aria-pressed": String(name === ""), "data-verdict": name}));
  const all = button("Open all", () => {
    shown.open = !shown.open;
    rows.forEach(row => row.open(shown.open));
    all.textContent = shown.open ? "Close all" : "Open all";
  }, {class: "plain"});

  function show(name) {
    shown.verdict = name;
    for (const filter of filters) filter.setAttribute("aria-pressed", String(filter.dataset.verdict === name));
    rows.forEach(({body, claim}) => { body.hidden = name !== "" && claim.verdict !== name; });
    const count = rows.filter(row => !row.body.hidden).length;
    status.textContent = `Showing ${count} of ${plural(rows.length, "claim")}`;
  }
  show("");
  return [
    el("p.explain", "Differences are left minus right; ", el("code", ">"), " means better, whichever way the metric ",
      "runs. A claim holds, or fails, on a scene where the whole 95 % interval lies on its side, or on the other."),
    el("div.filters", {role: "group", "aria-label": "Verdicts shown"}, filters, all, status),
    scroller("Claims", table),
  ];
}

/** The row of a claim, and below it those of its scenes. */
function claimRows(report, claim, number) {
  const id = `claim-${number}`;
  const inner = el("tr.inside", {id, hidden: true});
  const toggle = button(el("code", claim.claim), () => open(inner.hidden),
    {class: "claim", "aria-expanded": "false", "aria-controls": id});
  function open(yes) {
    if (yes && !inner.firstChild) inner.append(el("td", {colspan: "3"}, sceneTable(report, claim)));
    inner.hidden = !yes;
    toggle.setAttribute("aria-expanded", String(yes));
  }
  const body = el("tbody", el("tr", el("td", verdict(claim.verdict)), el("td", toggle),
    el("td.small", claim.scope, claim.note ? `: ${claim.note}` : "")), inner);
  return {claim, body, open};
}

function sceneTable(report, claim) {
  const metric = report.metrics[claim.metric];
  const scale = scaleOf(claim.scenes.map(row => [row.lo, row.difference, row.hi]), true);
  return el("table.scenes",
    el("thead", el("tr", el("th", {scope: "col"}, "Scene"), el("th", {scope: "col"}, "Verdict"),
      el("th.figure", {scope: "col"}, "Difference in ", metricName(metric, claim.metric)),
      el("th", {scope: "col"}, el("span.sr", "Interval drawn")),
      el("th.figure", {scope: "col"}, "95 % interval"), el("th.figure", {scope: "col"}, "Images"),
      el("th", {scope: "col"}, "Note"))),
    el("tbody", claim.scenes.map(row => el("tr", el("th", {scope: "row"}, row.scene), el("td", verdict(row.verdict)),
      el("td.figure", figure(row.difference, metric)),
      el("td", strip(row.difference, row.lo, row.hi, scale, {zero: true, kind: VERDICTS[row.verdict] ? row.verdict : ""})),
      el("td.figure", interval(row.lo, row.hi, metric)), el("td.figure", row.n === null ? NONE : row.n),
      el("td.small", row.note)))));
}
