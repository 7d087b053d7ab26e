/* Pictures: two of a row over each other with a divider to drag, cut out of the one figure.png. */

function picturesSection(report) {
  const parts = [];
  if (report.figure) {
    const image = pngImage(report.figure, "Reference, methods and error maps");
    if (report.figure.rows.length) parts.push(viewer(report.figure, image));
    if (report.figure.note) parts.push(el("p.note", inlineCode(report.figure.note)));
    parts.push(el("details.whole", {open: !report.figure.rows.length}, el("summary", "The whole figure"),
      scroller("The whole figure", image)));
  }
  for (const picture of report.pictures)
    parts.push(el("figure.picture", scroller(picture.caption || picture.file, pngImage(picture, picture.caption || picture.file)),
      picture.caption ? el("figcaption", picture.caption) : null));
  return parts;
}

/** Made only when its section opens: until then the PNG is text, and nothing is decoded. */
function pngImage(picture, alt) {
  return el("img", {src: `data:image/png;base64,${picture.png}`, width: picture.width, height: picture.height, alt, decoding: "async"});
}

/** `code` between backticks. */
function inlineCode(text) {
  return text.split("`").map((part, i) => i % 2 ? el("code", part) : part);
}

function viewer(figure, image) {
  const state = {row: figure.rows[0], left: 0, right: 1, errors: false, at: 50};
  const left = el("canvas"), right = el("canvas.over");
  const tags = [el("span.tag.left"), el("span.tag.right")];
  const handle = el("div.handle", {tabindex: "0", role: "slider", "aria-label": "Divider between the two pictures",
    "aria-valuemin": "0", "aria-valuemax": "100", "aria-orientation": "horizontal"});
  const stage = el("div.stage", left, right, ...tags, handle);
  const thumbs = el("div.thumbs", {role: "group", "aria-label": "Pictures of this row"});
  const facts = el("p.small.facts");
  const sides = el("div.sides");
  const errors = button("Error maps", () => { state.errors = !state.errors; draw(); }, {class: "switch", "aria-pressed": "false"});
  const scale = el("p.errors", el("span", "0"), el("i.magma"), el("span", `≥ ${figure.error_end}`),
    " mean difference to the reference in displayed (sRGB) values");
  const rows = figure.rows.map(row => button(row.facts.label ?? "", () => openRow(row), {class: "tab"}));

  function openRow(row) {
    const before = [state.left, state.right].map(i => state.row.columns[i]?.label);
    const place = label => row.columns.findIndex(column => column.label === label);
    state.row = row;
    state.left = Math.max(place(before[0]), 0);
    state.right = place(before[1]) >= 0 ? place(before[1]) : Math.min(1, row.columns.length - 1);
    rows.forEach((tab, i) => tab.setAttribute("aria-pressed", String(figure.rows[i] === row)));
    const {label, ...others} = row.facts;
    facts.textContent = Object.entries(others).map(([name, text]) => `${name} ${text}`).join(" · ");
    const options = row.columns.map((column, i) => [String(i), column.label]);
    fill(sides,
      choice("Left", options, String(state.left), value => { state.left = Number(value); draw(); }).node,
      button("⇄", () => { [state.left, state.right] = [state.right, state.left]; openRow(row); }, {class: "plain", "aria-label": "Swap left and right"}),
      choice("Right", options, String(state.right), value => { state.right = Number(value); draw(); }).node, errors);
    fill(thumbs, row.columns.map((column, i) => button(
      [el("canvas"), el("span.name", column.label), el("span.small", column.psnr === null ? "" : `${column.psnr.toFixed(2)} dB`)],
      () => { state.right = i; openRow(row); }, {class: "thumb"})));
    draw();
  }

  /** The box of a column's picture, or of its error map where these are asked for and it has one. */
  function box(column) {
    return state.errors && column.error ? column.error : column.picture;
  }

  function paint(canvas, [x, y, width, height]) {
    Object.assign(canvas, {width, height});
    canvas.getContext("2d").drawImage(image, x, y, width, height, 0, 0, width, height);
  }

  function draw() {
    const columns = [state.row.columns[state.left], state.row.columns[state.right]];
    [left, right].forEach((canvas, i) => paint(canvas, box(columns[i])));
    columns.forEach((column, i) => {
      tags[i].textContent = column.label + (state.errors && column.error ? ", error" : "");
    });
    const [, , width, height] = columns[0].picture;
    stage.style.setProperty("--ratio", `${width} / ${height}`);
    stage.style.setProperty("--width", `${2 * width}px`);
    errors.setAttribute("aria-pressed", String(state.errors));
    scale.hidden = !(state.errors && columns.some(column => column.error));
    [...thumbs.children].forEach((thumb, i) => {
      paint(thumb.querySelector("canvas"), box(state.row.columns[i]));
      thumb.setAttribute("aria-pressed", String(i === state.left || i === state.right));
      thumb.dataset.side = i === state.left ? "left" : i === state.right ? "right" : "";
    });
    move(state.at);
  }

  function move(at) {
    state.at = Math.max(0, Math.min(100, at));
    stage.style.setProperty("--at", `${state.at}%`);
    handle.setAttribute("aria-valuenow", String(Math.round(state.at)));
    const [a, b] = [state.left, state.right].map(i => state.row.columns[i].label);
    handle.setAttribute("aria-valuetext", `${Math.round(state.at)} % ${a}, the rest ${b}`);
  }

  function follow(event) {
    const place = stage.getBoundingClientRect();
    move(100 * (event.clientX - place.left) / place.width);
  }
  stage.addEventListener("pointerdown", event => {
    if (event.button !== 0) return;
    stage.setPointerCapture(event.pointerId);
    handle.focus({preventScroll: true});
    follow(event);
    event.preventDefault();
  });
  stage.addEventListener("pointermove", event => { if (stage.hasPointerCapture(event.pointerId)) follow(event); });
  handle.addEventListener("keydown", event => {
    const step = event.shiftKey ? 10 : 2;
    const to = {ArrowLeft: state.at - step, ArrowDown: state.at - step, ArrowRight: state.at + step,
      ArrowUp: state.at + step, Home: 0, End: 100}[event.key];
    if (to === undefined) return;
    move(to);
    event.preventDefault();
  });
  image.decode().then(() => openRow(state.row)).catch(() => stage.replaceWith(el("p.note", "figure.png is damaged.")));
  return el("div.viewer", rows.length > 1 ? el("div.tabs", {role: "group", "aria-label": "Row"}, rows) : null,
    el("div.bench", el("div.show", sides, stage, scale, facts), thumbs));
}
