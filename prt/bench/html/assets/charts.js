/* Charts: the report's own SVG, already without anything active, with labels at its points. */

const tip = document.querySelector(".tip");

function chartsSection(report) {
  const all = report.charts.map(chart => {
    const svg = new DOMParser().parseFromString(chart.svg, "image/svg+xml").documentElement;
    if (svg.nodeName !== "svg") return null;
    const node = document.importNode(svg, true);
    const [width] = (node.getAttribute("viewBox") ?? "").split(/\s+/).slice(2);
    if (Number(width) > 0) node.style.width = `${Math.round(width * 1.45)}px`;
    node.setAttribute("role", chart.points ? "group" : "img");
    node.setAttribute("aria-label", chart.caption || (chart.file === "chart.svg" ? "Speed against accuracy" : chart.file));
    walkable([...node.querySelectorAll("circle.point")]);
    return el("figure.chart", scroller(chart.caption || chart.file, node),
      // the others have their title drawn in them
      chart.file === "chart.svg" && chart.caption ? el("figcaption", chart.caption) : null);
  });
  const mute = report.charts.some(chart => !chart.points);
  return [all, mute ? el("p.note", "Points of ", report.charts.every(chart => !chart.points) ? "these charts" : "some charts",
    " have no labels yet: they were drawn before charts had any; ", el("code", report.command), " draws them anew.") : null];
}

/** One stop of the tab key for all points of a chart; the arrows go from one to the next. */
function walkable(points) {
  points.forEach((point, i) => {
    labelled(point);
    point.setAttribute("tabindex", i ? "-1" : "0");
    point.addEventListener("keydown", event => {
      const to = {ArrowRight: i + 1, ArrowDown: i + 1, ArrowLeft: i - 1, ArrowUp: i - 1, Home: 0, End: points.length - 1}[event.key];
      if (!points[to]) return;
      for (const other of points) other.setAttribute("tabindex", other === points[to] ? "0" : "-1");
      points[to].focus();
      event.preventDefault();
    });
  });
}

/** A point shows its title in the page's own label, by pointer and by keyboard. */
function labelled(point) {
  const text = point.querySelector("title")?.textContent ?? "";
  point.replaceChildren();
  point.setAttribute("role", "img");
  point.setAttribute("aria-label", text.replaceAll("\n", "; "));
  point.addEventListener("pointerenter", () => showTip(point, text));
  point.addEventListener("pointerleave", hideTip);
  point.addEventListener("focus", () => showTip(point, text));
  point.addEventListener("blur", hideTip);
}

function showTip(point, text) {
  const [name, ...figures] = text.split("\n");
  fill(tip, el("b", name), figures.map(line => {
    const cut = line.lastIndexOf(": ");
    return cut < 0 ? el("p", line) : el("p", el("span", line.slice(0, cut)), " ", line.slice(cut + 2));
  }));
  tip.hidden = false;
  const at = point.getBoundingClientRect(), own = tip.getBoundingClientRect();
  const left = Math.max(8, Math.min(at.left + at.width / 2 - own.width / 2, innerWidth - own.width - 8));
  const above = at.top - own.height - 6;
  Object.assign(tip.style, {left: `${left}px`, top: `${above < 8 ? at.bottom + 6 : above}px`});
}

function hideTip() {
  tip.hidden = true;
}

addEventListener("scroll", hideTip, {passive: true, capture: true});
addEventListener("keydown", event => { if (event.key === "Escape") hideTip(); });
