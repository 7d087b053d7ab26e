/* The page of one table. */

function reportPage(number) {
  const entries = data("index"), entry = entries[number];
  const report = data(`report-${number}`);
  const sections = [
    ["pictures", "Pictures", report.figure || report.pictures.length ? () => picturesSection(report) : null],
    ["charts", "Charts", report.charts.length ? () => chartsSection(report) : null],
    ["claims", "Claims", report.claims.length ? () => claimsSection(report) : null],
    ["tables", "Tables", report.sheets.length ? () => sheetsSection(report) : null],
    ["results", "All results", report.results.value.length ? () => resultsSection(report) : null],
    ["how", "How it was measured", report.prose.length ? () => howSection(report) : null],
  ].filter(([, , make]) => make);
  const links = new Map(sections.map(([id, title]) => [id, el("a", {href: address(entry.name, id)}, title)]));
  const page = el("article.report",
    el("header",
      el("h1", {tabindex: "-1"}, report.title),
      el("div.about", prose(report.about)),
      factsOf(report, entry)),
    el("nav.sections", {"aria-label": "Sections"}, [...links.values()]),
    sections.map(([id, title, make]) =>
      el("section", {id, "aria-labelledby": `${id}-title`}, el("h2", {id: `${id}-title`}, title), make())),
    neighbours(entries, number));
  followScroll(page.querySelectorAll("section"), links);
  return page;
}

/** The link of the section in sight is marked. */
function followScroll(sections, links) {
  const watcher = new IntersectionObserver(seen => {
    for (const {target, isIntersecting} of seen)
      if (isIntersecting) for (const [id, link] of links)
        if (id === target.id) link.setAttribute("aria-current", "true"); else link.removeAttribute("aria-current");
  }, {rootMargin: "-25% 0px -70% 0px"});
  for (const section of sections) watcher.observe(section);
}

/** What came out, and where it was measured. */
function factsOf(report, entry) {
  const {commit, changed, date, device, budget} = report.facts;
  const facts = [
    ["Command", el("code", report.command)],
    ["Budget", budget], ["Device", device], ["Measured", date && el("time", {datetime: date}, date)],
    ["Commit", commit && [el("code", commit), changed ? " with uncommitted changes" : ""]],
  ].filter(([, value]) => value);
  const counts = verdictList(entry.verdicts);
  return [
    counts.length ? el("div.score", verdictBlocks(entry.verdicts), el("p.verdicts", counts)) : null,
    el("dl.facts", facts.map(([name, value]) => el("div", el("dt", name), el("dd", value)))),
  ];
}

function howSection(report) {
  return report.prose.map(part => part.title.startsWith("How it was") ? el("div.prose", prose(part.blocks))
    : el("details.prose", el("summary", part.title), prose(part.blocks)));
}

function neighbours(entries, number) {
  const link = (other, label) => other && el("a", {href: address(other.name)},
    el("span.small", label), el("span", other.title));
  return el("nav.neighbours", {"aria-label": "Other tables"},
    link(entries[number - 1], "Before") || el("span"), link(entries[number + 1], "Next"));
}
