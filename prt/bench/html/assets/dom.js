"use strict";
/* Elements. A text that comes from a report only ever becomes a text node or an attribute's value. */

/** el("td.number", {title: "x"}, "text", child, [more]): names, classes and properties, then what it holds. */
function el(spec, properties, ...inside) {
  const [name, ...classes] = spec.split(".");
  const node = document.createElement(name);
  if (classes.length) node.className = classes.join(" ");
  const isProperties = properties && properties.constructor === Object;
  for (const [key, value] of Object.entries(isProperties ? properties : {})) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") node.addEventListener(key, value);
    else node.setAttribute(key, value === true ? "" : value);
  }
  add(node, isProperties ? inside : [properties, ...inside]);
  return node;
}

/** Append texts, nodes and lists of them; nothing for null. */
function add(node, inside) {
  for (const one of inside) {
    if (one === null || one === undefined || one === false) continue;
    if (Array.isArray(one)) add(node, one);
    else node.append(one instanceof Node ? one : String(one));
  }
  return node;
}

/** Replace what a node holds. */
function fill(node, ...inside) {
  node.replaceChildren();
  return add(node, inside);
}

/** A button that does something; `pressed` where it is a switch. */
function button(label, action, properties = {}) {
  return el("button", {type: "button", click: action, ...properties}, label);
}

/** A label over a select; `options` are [value, text]. */
function choice(label, options, value, changed) {
  const select = el("select", {change: () => changed(select.value)},
    options.map(([key, text]) => el("option", {value: key}, text)));
  select.value = value;
  return {node: el("label.choice", el("span", label), select), select};
}

/** A wide thing that scrolls sideways, by keyboard as well. */
function scroller(label, ...inside) {
  return el("div.scroll", {tabindex: "0", role: "region", "aria-label": label}, inside);
}

/** Data of the page, parsed where it is first needed. */
const parsed = new Map();
function data(id) {
  if (!parsed.has(id)) parsed.set(id, JSON.parse(document.getElementById(id).textContent));
  return parsed.get(id);
}
