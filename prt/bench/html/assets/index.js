/* The index: all tables by paper, and the search over them. */

/** What is searched in a table, word for word in the results: [kind, texts]. */
function searched(entry) {
  return [
    ["table", [entry.name]], ["title", [entry.title]], ["about", [entry.about]], ["claim", entry.claims.map(([claim, verdict]) => `${claim}: ${verdict}`)],
    ["method", entry.words.method], ["variant", entry.words.variant], ["scene", entry.words.scene],
    ["split", entry.words.split], ["metric", entry.words.metric],
  ];
}

/** Where a table has every word of the query, or null; each word may stand in another text. */
function found(entry, words) {
  const texts = searched(entry).flatMap(([kind, all]) => all.map(text => ({kind, text, low: text.toLowerCase()})));
  const all = [paperName(entry.paper).toLowerCase(), ...texts.map(one => one.low)];
  if (!words.every(word => all.some(text => text.includes(word)))) return null;
  const hits = texts.filter(one => !["title", "table"].includes(one.kind) && words.some(word => one.low.includes(word)));
  return ranked(hits, words);
}

/** First the texts that together have all the words, each with as many of those still missing as can be. */
function ranked(hits, words) {
  const first = [];
  let missing = words, left = hits;
  while (missing.length && left.length) {
    const news = one => missing.filter(word => one.low.includes(word)).length;
    const best = left.reduce((a, b) => news(b) > news(a) ? b : a);
    if (!news(best)) break;
    first.push(best);
    missing = missing.filter(word => !best.low.includes(word));
    left = left.filter(one => one !== best);
  }
  return [...first, ...left];
}

/** A text with the words of the query marked; of a long one only the part around the first. */
function marked(text, words, room = 0) {
  const low = text.toLowerCase();
  const first = Math.min(...words.map(word => low.indexOf(word)).filter(at => at >= 0), text.length);
  const from = room && first > room ? low.lastIndexOf(" ", first - room / 2) + 1 : 0;
  const to = room && text.length > from + 2 * room ? from + 2 * room : text.length;
  const parts = [from ? "… " : ""];
  for (let at = from; at < to;) {
    const next = words.map(word => [low.indexOf(word, at), word.length]).filter(([i]) => i >= 0 && i < to)
      .sort((a, b) => a[0] - b[0] || b[1] - a[1])[0];
    parts.push(text.slice(at, next ? next[0] : to));
    if (!next) break;
    parts.push(el("mark", text.slice(next[0], next[0] + next[1])));
    at = next[0] + next[1];
  }
  return [...parts, to < text.length ? " …" : ""];
}

function indexPage(query) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  const entries = data("index").map(entry => ({entry, hits: found(entry, words)})).filter(one => one.hits);
  const page = el("div.index");
  page.append(el("h1", {tabindex: "-1"}, words.length ? "Search" : "Measured results"));
  page.append(words.length
    ? el("p.lead", {role: "status"}, `${plural(entries.length, "table")} with `, el("q", query.trim()), ".")
    : overview(data("index")));
  for (const [paper, group] of byPaper(entries)) {
    page.append(el("section.paper", {"aria-label": paperName(paper)},
      el("h2", paperName(paper), el("span.count", plural(group.length, "table"))),
      el("ol.tables", group.map(({entry, hits}) => indexRow(entry, hits, words)))));
  }
  if (!entries.length) page.append(el("p.none", "No table has all of these words. Try fewer of them."));
  return page;
}

function byPaper(entries) {
  const papers = new Map();
  for (const one of entries) papers.set(one.entry.paper, [...(papers.get(one.entry.paper) ?? []), one]);
  return papers;
}

/** How many tables there are, and what became of their claims. */
function overview(entries) {
  const sum = name => entries.reduce((total, entry) => total + entry.verdicts[name], 0);
  const counts = Object.fromEntries(Object.keys(VERDICTS).map(name => [name, sum(name)]));
  const claims = Object.values(counts).reduce((a, b) => a + b, 0);
  const papers = new Set(entries.map(entry => entry.paper).filter(paper => /\d{4}/.test(paper))).size;
  const figures = entries.reduce((total, entry) => total + entry.figures, 0);
  return el("div.overview",
    el("p.lead", `${plural(entries.length, "table")}${papers ? ` from ${plural(papers, "paper")}` : ""}, `,
      `${plural(figures, "result")}, ${plural(claims, "claim")} tested on this project's own runs.`),
    claims ? el("div.score", verdictBlocks(counts), el("p.verdicts", verdictList(counts))) : null,
    el("p.hint", "A claim holds, or fails, where the whole 95 % interval of the difference lies on its side, or ",
      "on the other; else it is undecided. A claim that fails is a result. Published numbers come from the ",
      "papers' own scenes and machines and never share a column with measured ones."));
}

function verdictList(counts) {
  return Object.keys(VERDICTS).filter(name => counts[name]).map(name => verdict(name, counts[name]));
}

function indexRow(entry, hits, words) {
  const claims = Object.values(entry.verdicts).some(Boolean);
  const holds = [plural(entry.figures, "result"), entry.charts && plural(entry.charts, "chart"),
    entry.pictures && plural(entry.pictures, "picture")].filter(Boolean).join(", ");
  return el("li.row",
    el("div.what",
      el("a", {href: address(entry.name)}, marked(entry.title, words)),
      el("p.small", el("code", marked(entry.name, words)), " ", holds),
      words.length && hits.length ? el("ul.hits", hits.slice(0, 3).map(({kind, text}) =>
        el("li", el("span.kind", kind), " ", marked(text, words, 60))),
        hits.length > 3 ? el("li.more", `and ${hits.length - 3} more`) : null) : null),
    el("div.claims", claims ? [verdictBlocks(entry.verdicts), el("p.verdicts", verdictList(entry.verdicts))]
      : el("p.small", "no claims")),
    el("div.when", entry.date ? el("time", {datetime: entry.date}, entry.date) : null,
      entry.commit ? el("code", {title: `commit ${entry.commit}`}, entry.commit.split(", ").map(c => c.slice(0, 8)).join(" ")) : null));
}
