/* Which page is shown: #/ the index, #/?q=words a search, #/paper/table a table, #/paper/table::claims in it. */

const main = document.getElementById("main");
const search = document.getElementById("search");
const path = document.querySelector("nav.path");
let shown = null;

function address(name, section = "") {
  return "#/" + name.split("/").map(encodeURIComponent).join("/") + (section && `::${section}`);
}

function route() {
  let text = location.hash.replace(/^#\/?/, "");
  const query = text.startsWith("?q=");
  let section = "";
  if (!query) [text, section = ""] = text.split("::");
  try { text = decodeURIComponent(query ? text.slice(3) : text); } catch { /* as it is written */ }
  return query || !text ? {query: query ? text : ""} : {name: text, section};
}

function show() {
  hideTip();
  const {query = "", name, section} = route();
  const key = name === undefined ? `?${query}` : name;
  const entries = data("index");
  const number = entries.findIndex(entry => entry.name === name);
  if (document.activeElement !== search) search.value = query;
  if (key !== shown) {
    const first = shown === null;
    shown = key;
    fill(main, name === undefined ? indexPage(query) : number < 0 ? missing(name) : reportPage(number));
    fill(path, name === undefined ? null : [el("a", {href: "#/"}, "All tables"), " / ",
      number < 0 ? "" : [paperName(entries[number].paper), " / ", el("span", {"aria-current": "page"}, tableName(name))]]);
    document.title = number < 0 ? "prt report" : `${tableName(name)}, ${entries[number].title}`;
    scrollTo(0, 0);
    // the keyboard goes on where the page begins, but for who is typing a search
    if (!first && document.activeElement !== search) main.querySelector("h1")?.focus({preventScroll: true});
  }
  if (section) document.getElementById(section)?.scrollIntoView();
}

function missing(name) {
  return el("div.index", el("h1", {tabindex: "-1"}, "No such table"),
    el("p.lead", `This file has no table ${name}. `, el("a", {href: "#/"}, "All tables")));
}

search.addEventListener("input", () => {
  // the first letter leaves a table, and the back button finds it again
  const go = route().name === undefined ? "replaceState" : "pushState";
  history[go](null, "", search.value.trim() ? `#/?q=${encodeURIComponent(search.value)}` : "#/");
  show();
});
search.addEventListener("keydown", event => {
  if (event.key === "Escape" && search.value) {
    search.value = "";
    search.dispatchEvent(new Event("input"));
    event.preventDefault();
  }
});
addEventListener("keydown", event => {
  const typing = event.target.closest?.("input, select, textarea");
  if (event.key !== "/" || typing || event.ctrlKey || event.metaKey || event.altKey) return;
  search.focus();
  search.select();
  event.preventDefault();
});
document.querySelector(".skip").addEventListener("click", event => {
  event.preventDefault();  // the address says which table is open
  main.focus();
});
addEventListener("popstate", show);
show();
