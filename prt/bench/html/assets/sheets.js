/* The tables of the paper's layout, and running text: blocks and spans made into elements. */

const EMPHASIS = {b: "b", i: "em", code: "code"};

function inline(spans) {
  return spans.map(span => typeof span === "string" ? span : span[0] === "link" ? linked(span)
    : el(EMPHASIS[span[0]] ?? "span", span[1]));
}

/** A link to another report, where this page has it. */
function linked([, text, name]) {
  return data("index").some(entry => entry.name === name) ? el("a", {href: address(name)}, text) : text;
}

function prose(blocks) {
  return blocks.map(block =>
    block.kind === "list" ? el("ul", block.items.map(item => el("li", inline(item))))
      : block.kind === "h" ? el("h4", block.text)
        : block.kind === "p" ? el("p", inline(block.spans)) : null);
}

function spansText(spans) {
  return spans.map(span => typeof span === "string" ? span : span[1]).join("");
}

/** Heads as `Kitchen, far views` in two rows, where the last words stand over several columns each. */
function headRows(sheet) {
  const lead = sheet.figures.indexOf(true) < 0 ? sheet.heads.length : sheet.figures.indexOf(true);
  const texts = sheet.heads.map(spansText);
  const cut = texts.map((text, i) => i < lead ? -1 : text.lastIndexOf(", "));
  const group = texts.map((text, i) => cut[i] < 0 ? "" : text.slice(cut[i] + 2));
  const runs = [];
  for (let i = lead; i < texts.length; i++) {
    if (runs.length && runs[runs.length - 1].name === group[i]) runs[runs.length - 1].span++;
    else runs.push({name: group[i], span: 1});
  }
  const names = new Set(runs.map(run => run.name));
  const grouped = cut.slice(lead).every(at => at >= 0) && names.size === runs.length
    && runs.some(run => run.span > 1);
  if (!grouped) return {lead, rows: [el("tr", texts.map((text, i) => headCell(text, sheet.figures[i])))], starts: []};
  const starts = [];
  let at = lead;
  for (const run of runs) { starts.push(at); at += run.span; }
  return {lead, starts, rows: [
    el("tr", texts.slice(0, lead).map(text => el("th", {scope: "col", rowspan: "2"}, text)),
      runs.map(run => el("th.group.edge", {scope: "colgroup", colspan: run.span}, run.name))),
    el("tr", texts.slice(lead).map((text, i) =>
      el("th.figure" + (starts.includes(i + lead) ? ".edge" : ""), {scope: "col"}, text.slice(0, cut[i + lead])))),
  ]};
}

function headCell(text, isFigure) {
  return el("th" + (isFigure ? ".figure" : ""), {scope: "col"}, text);
}

/** A table without the columns that say nothing, as `component` where nothing has one. */
function withoutEmpty(sheet) {
  const says = sheet.heads.map((_, i) => sheet.rows.some(row => row[i] && spansText(row[i]) !== ""));
  const kept = list => list.filter((_, i) => says[i] ?? true);
  return {...sheet, heads: kept(sheet.heads), figures: kept(sheet.figures), rows: sheet.rows.map(kept)};
}

/** One table of table.md. */
function sheetTable(whole) {
  const sheet = withoutEmpty(whole);
  const {lead, rows, starts} = headRows(sheet);
  let before = null;
  const body = sheet.rows.map(row => {
    const texts = row.slice(0, lead).map(spansText);
    // what the row above says already stands there in grey
    let same = before !== null;
    const again = texts.map((text, i) => (same = same && i < lead - 1 && text === before[i]));
    const first = before !== null && texts[0] !== before[0];
    before = texts;
    return el("tr" + (first ? ".first" : ""), row.map((cell, i) => i < lead
      ? el((i === 0 ? "th" : "td") + (again[i] ? ".again" : ""), i === 0 ? {scope: "row"} : {}, inline(cell))
      : el("td.figure" + (starts.includes(i) ? ".edge" : ""), inline(cell))));
  });
  return scroller(sheet.title || "Table",
    el("table.sheet" + (sheet.published ? ".published" : ""), el("thead", rows), el("tbody", body)));
}

/** All tables of a report: the first one open, the published ones in their own colour. */
function sheetsSection(report) {
  return report.sheets.map((sheet, i) => el("details.sheet" + (sheet.published ? ".published" : ""),
    {open: i === 0 || sheet.published},
    el("summary", sheet.title || "Measured by this project"),
    sheetTable(sheet),
    sheet.notes.length ? el("ul.notes", sheet.notes.map(note => el("li", inline(note)))) : null));
}
