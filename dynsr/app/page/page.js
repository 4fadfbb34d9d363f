"use strict";
const $ = id => document.getElementById(id);
const parts = {};
let version = 0, over = false;

// Words of the data are only ever text; markup is made by dynsr from formulas and pictures.
const make = (tag, given = {}, ...children) => {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(given)) {
    if (name in made) made[name] = value; else made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
};
const show = (id, wanted) => { $(id).hidden = !wanted; };
const list = (id, lines) => $(id).replaceChildren(...lines.map(line => make("li", {}, line)));
const level = words => (words || "").replace(" ", "-");

const complain = words => {
  $("said").textContent = words || "";
  show("said", words);
  if (words) $("said").scrollIntoView({ block: "nearest" });
};
// One after the other: columns that were corrected are there before a search begins.
let posted = Promise.resolve();
const post = (wish, content = {}) => (posted = posted.then(() => send(wish, content)));
const send = async (wish, content) => {
  try {
    const answer = await fetch(wish, { method: "POST", body: JSON.stringify(content), headers: { "Content-Type": "application/json" } });
    const said = await answer.json().catch(() => ({}));
    if (!answer.ok) complain(said.error || `this was refused (${answer.status}); load the page again`);
    return answer.ok;
  } catch { return false; }
};

// What was found is lost by some wishes. Once the report or the result is downloaded, nobody asks.
let kept = false;
const mayLose = action => new Promise(answer => {
  const searching = parts.busy === "search";
  if (!searching && (!parts.found || kept)) { answer(true); return; }
  const dialog = $("sure");
  $("sure-words").textContent = searching
    ? "A search is running. Its equations will be lost."
    : "The equations that were found will be lost. Download the report or the result to keep them.";
  $("sure-yes").textContent = action;
  dialog.returnValue = "no";
  dialog.addEventListener("close", () => answer(dialog.returnValue === "yes"), { once: true });
  dialog.showModal();
});

// ---- data
const upload = async file => {
  const about = parts.about || {};
  if (about.largest && file.size > about.largest) {
    complain(`'${file.name}' has ${(file.size / 2 ** 20).toFixed(1)} MB, more than the ${about.largest / 2 ** 20} MB that are taken; give fewer rows, or start dynsr app with a larger --megabytes`);
    return;
  }
  complain("");
  if (!await mayLose("Read the other file")) return;
  try {
    const answer = await fetch(`data?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file, headers: { "Content-Type": "application/octet-stream" } });
    if (!answer.ok) complain((await answer.json().catch(() => ({}))).error || "the file was refused");
  } catch { complain("the file could not be sent; is dynsr still running?"); }
};
const ROLES = { time: "time", state: "state", input: "input", dose: "doses of a state", trajectory: "names the run", quantity: "names the quantity", unused: "not used" };
const HOLDS = { previous: "keeps its value between rows", linear: "straight between rows", smooth: "smooth between rows" };

const showTable = table => {
  show("table", table);
  if (!table) return;
  $("guess").textContent = table.error || table.guess;
  $("guess").className = table.error ? "bad" : "";
  list("notes", [...table.loaded, ...table.notes.filter(note => !table.loaded.includes(note))]);
  const focused = document.activeElement && document.activeElement.id;
  const changed = () => {
    const roles = {}, units = {}, ways = {};
    for (const column of table.columns) { roles[column.name] = column.role; units[column.name] = column.unit; ways[column.name] = column.way; }
    post("columns", { roles, units, ways });
  };
  const heads = table.columns.map((column, j) => {
    const role = make("select", { id: `role-${j}`, ariaLabel: `Role of ${column.name}` },
      ...Object.entries(ROLES).map(([value, words]) => make("option", { value, selected: value === column.role }, words)));
    role.addEventListener("change", async () => {
      if (!await mayLose("Change the column")) { role.value = column.role; return; }
      // There is one time, and one column that names quantities; several may name the runs.
      for (const other of table.columns) if (other.role === role.value && ["time", "quantity"].includes(role.value)) other.role = "unused";
      column.role = role.value;
      column.way = "";
      changed();
    });
    const unit = make("input", { id: `unit-${j}`, value: column.unit, placeholder: "unit", ariaLabel: `Unit of ${column.name}`, maxLength: 40 });
    unit.addEventListener("change", async () => {
      if (!await mayLose("Change the unit")) { unit.value = column.unit; return; }
      column.unit = unit.value.trim();
      changed();
    });
    unit.hidden = ["unused", "trajectory", "quantity", "dose"].includes(column.role);
    const states = table.columns.filter(other => other.role === "state").flatMap(other => [
      [other.name, `added to ${other.name}`],
      [`${other.name}/V`, `divided by a volume V that is fitted, added to ${other.name}`],
    ]);
    const ways = { input: Object.entries(HOLDS), dose: states }[column.role] || [];
    const way = make("select", { id: `way-${j}`, className: "way", ariaLabel: `${column.role === "dose" ? "State of the doses" : "Between rows"}: ${column.name}`, hidden: !ways.length },
      ...ways.map(([value, words]) => make("option", { value, selected: value === column.way }, words)));
    way.addEventListener("change", async () => {
      if (!await mayLose("Change the column")) { way.value = column.way; return; }
      column.way = way.value;
      changed();
    });
    return make("th", { className: column.role, scope: "col" }, column.name, role, unit, ...(ways.length ? [way] : []));
  });
  $("columns").tHead.replaceChildren(make("tr", {}, ...heads));
  const count = Math.max(0, ...table.columns.map(column => column.cells.length));
  $("columns").tBodies[0].replaceChildren(...Array.from({ length: count }, (_, i) =>
    make("tr", {}, ...table.columns.map(column => make("td", { className: column.role }, column.cells[i])))));
  $("rows").textContent = `The first ${count} of ${table.rows} rows.` + (table.hidden ? ` ${table.hidden} more columns are not shown, and not used once a role is changed.` : "");
  if (focused && $(focused)) $(focused).focus();
};

// ---- search
const PRESETS = { best: "Thorough", quick: "Quick look", paper: "As in the paper" };
const showChoices = choices => {
  if (!choices) return;
  $("presets").replaceChildren($("presets").firstElementChild, ...Object.entries(choices.presets).map(([name, meaning]) =>
    make("label", {}, make("input", { type: "radio", name: "preset", value: name, checked: name === choices.preset }),
      make("span", {}, PRESETS[name] || name, make("small", {}, meaning)))));
  $("functions").replaceChildren(...choices.functions.map(name =>
    make("label", { className: "tick" }, make("input", { type: "checkbox", name: "function", value: name, disabled: !$("own").checked }), name)));
};
const readOptions = () => {
  const form = $("options"), options = {};
  for (const name of ["scheme", "time_budget", "max_complexity", "terms", "conserved", "seed"]) {
    const value = form.elements[name].value.trim();
    if (value) options[name] = value;
  }
  for (const name of ["snap", "nonnegative", "units", "second_order", "explicit_time", "discrete"]) options[name] = form.elements[name].checked;
  const preset = form.querySelector("[name=preset]:checked");
  if (preset) options.preset = preset.value;
  if ($("own").checked) options.functions = [...form.querySelectorAll("[name=function]:checked")].map(box => box.value);
  return options;
};
const card = (given, chip, why) => make("article", { className: `equation ${level(given.level)}` },
  ...(chip ? [make("span", { className: "chip" }, chip)] : []),
  Object.assign(make("div", { className: "formula", tabIndex: 0, title: given.text }), { innerHTML: given.mathml }),
  ...(why ? [make("p", {}, why)] : []));

const showProgress = progress => {
  const busy = parts.busy;
  show("progress", busy === "search" || busy === "stopping" || busy === "read");
  $("doing").textContent = { read: "Reading", stopping: "Ending" }[busy] || "Searching";
  $("stop").disabled = busy === "stopping";
  if (progress && progress.share !== null) $("bar").value = progress.share; else $("bar").removeAttribute("value");
  $("left").textContent = progress ? [progress.tasks, progress.time, progress.left].filter(Boolean).join(" · ") : "";
  list("running", progress ? progress.running.map(one => [one.title, one.stage].filter(Boolean).join(": ")) : []);
  const best = progress ? Object.values(progress.best) : [];
  $("best").replaceChildren(...best.map(one => card(one, one.stage, one.error)));
};

// ---- what was found
// The picture says what it shows, and sliders follow it, but where they were moved since.
let sliders = [], waiting = 0, asked = null;
const isMoved = () => sliders.some(one => one.value !== one.found);
const nameOf = (values, run) => JSON.stringify([values, run]);
const redraw = () => {
  clearTimeout(waiting);
  waiting = setTimeout(async () => {
    waiting = 0;
    const values = {}, run = Number($("run").value) || 0;
    if (isMoved()) for (const one of sliders) (values[one.state] ||= []).push(one.value);
    show("reset", isMoved());
    $("svg").classList.add("waiting");
    asked = nameOf(values, run);
    if (!await post("redraw", { values, run })) follow(parts.picture, true);
  }, 120);
};
const follow = (picture, anyway) => {
  if (!picture) { asked = null; return; }
  if (anyway || asked === nameOf(picture.values, picture.run)) asked = null;
  if (waiting || asked !== null) return;
  const left = Object.fromEntries(Object.entries(picture.values).map(([state, own]) => [state, [...own]]));
  for (const one of sliders) one.put(left[one.state] ? left[one.state].shift() : one.found);
  $("run").value = picture.run;
  show("reset", isMoved());
  $("svg").classList.remove("waiting");
};
const slider = (one, left, unit) => {
  const own = { state: one.state, value: one.value, found: one.value };
  const reach = Math.abs(one.value) || 1;
  const range = make("input", { type: "range", step: "any", ariaLabel: `Constant of ${one.of} in ${one.state}${left}` });
  const number = make("input", { type: "number", step: "any", ariaLabel: `Value of the constant of ${one.of} in ${one.state}${left}` });
  const put = value => {
    if (!Number.isFinite(value)) return;
    own.value = value;
    range.min = Math.min(one.value - reach, value); range.max = Math.max(one.value + reach, value);
    range.value = value; number.value = Number(value.toPrecision(6));
  };
  own.put = put;
  range.addEventListener("input", () => { put(range.valueAsNumber); redraw(); });
  number.addEventListener("change", () => { put(number.valueAsNumber); redraw(); });
  put(one.value);
  own.rows = [
    make("tr", {}, make("td", {}, one.name),
      make("td", {}, one.of, make("small", {}, ` in ${one.state}${left}${unit && one.unit ? `, ${one.unit}` : ""}`)),
      make("td", { title: `fitted ${one.fitted}` }, one.interval), make("td", {}, number)),
    make("tr", {}, make("td", { colSpan: 4 }, range))];
  return own;
};
const showFound = (found, fresh) => {
  kept = false;
  show("found", found);
  show("code", found);
  show("goes", found && (found.points.length || found.flow));
  clearTimeout(waiting);
  waiting = 0;
  asked = null;
  if (!found) { sliders = []; show("constants", false); return; }
  $("verdict").textContent = found.complete ? found.heading : "Cancelled. These are the best equations so far, without a verdict.";
  $("verdict").className = `banner ${level(found.level)}`;
  list("said-found", found.notes);
  $("equations").replaceChildren(...found.equations.map(one => card(one, one.level, one.why)));
  $("python").textContent = found.python;
  list("points", found.points);
  $("flow").innerHTML = found.flow;
  $("branches").innerHTML = found.branches ? found.branches.svg : "";
  $("branches-words").textContent = found.branches ? found.branches.caption : "";
  $("exports").replaceChildren(...found.exports.map(one => make("a", { className: "button", href: one.file, download: "" }, one.title)));
  sliders = found.constants.map(one => slider(one, found.left, found.units));
  $("rows-of-constants").replaceChildren(...sliders.flatMap(one => one.rows));
  show("constants", sliders.length);
  show("reset", false);
  show("runs", found.runs.length > 1);
  $("run").replaceChildren(...found.runs.map((name, j) => make("option", { value: j }, name)));
  if (fresh) $("found").scrollIntoView({ behavior: "smooth" });
};
const showPicture = picture => {
  show("picture", picture);
  follow(picture);
  if (!picture) { $("svg").replaceChildren(); return; }
  $("svg").innerHTML = picture.svg;
  $("picture-said").textContent = picture.said || "";
  $("lines").textContent = (picture.lines || []).join("\n");
};

// ---- what dynsr says
const showPreview = preview => {
  $("preview-svg").innerHTML = preview ? preview.svg : "";
  $("preview-said").textContent = preview ? preview.said : "";
};
const DRAW = { preview: showPreview, choices: showChoices, table: showTable, picture: showPicture, said: complain };
const draw = (changed, first) => {
  Object.assign(parts, changed);
  if ("found" in changed) showFound(parts.found, !first);
  for (const name of Object.keys(changed)) if (DRAW[name]) DRAW[name](parts[name]);
  // What was asked for could not be drawn.
  if (changed.said) follow(parts.picture, true);
  if ("progress" in changed || "busy" in changed) showProgress(parts.progress);
  if ("about" in changed) $("limit").textContent = `Up to ${parts.about.largest / 2 ** 20} MB`;
  const idle = !parts.busy, table = parts.table;
  show("start", !table && idle);
  show("forget", table && idle);
  show("ask", table && idle && !table.error && table.states.length);
  for (const one of document.querySelectorAll("#columns :is(select, input)")) one.disabled = !idle;
  if (changed.busy === "search" && !first) $("progress").scrollIntoView({ behavior: "smooth", block: "nearest" });
};
const leave = words => {
  over = true;
  complain(words);
  for (const one of document.querySelectorAll("button, input, select")) one.disabled = true;
};
const listen = async () => {
  for (let misses = 0; !over;) {
    try {
      const answer = await fetch(`changes?after=${version}`, { cache: "no-store" });
      if (!answer.ok) throw new Error(answer.status);
      const news = await answer.json(), first = version === 0;
      version = news.version;
      misses = 0;
      draw(news.parts, first);
    } catch {
      if (over) return;
      if (++misses > 3) leave("dynsr has ended; start it again with: dynsr app");
      await new Promise(wake => setTimeout(wake, 500));
    }
  }
};

$("file").addEventListener("change", () => { if ($("file").files[0]) upload($("file").files[0]); $("file").value = ""; });
for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, event => {
    event.preventDefault();
    document.body.classList.toggle("over", name === "dragover");
    if (name === "drop" && event.dataTransfer.files[0]) upload(event.dataTransfer.files[0]);
  });
}
$("own").addEventListener("change", () => { for (const box of document.querySelectorAll("[name=function]")) box.disabled = !$("own").checked; });
$("example").addEventListener("click", () => { complain(""); post("example"); });
$("options").addEventListener("submit", async event => {
  event.preventDefault();
  const options = readOptions();
  if (await mayLose("Search again")) post("search", { options });
});
$("stop").addEventListener("click", () => post("stop"));
$("forget").addEventListener("click", async () => { if (await mayLose("Take other data")) post("forget"); });
$("quit").addEventListener("click", async () => {
  if (await mayLose("Quit") && await post("quit")) leave("dynsr has ended; this page can be closed");
});
for (const link of document.querySelectorAll("#downloads a[href='report.html'], #downloads a[href='discovery.json']"))
  link.addEventListener("click", () => { kept = true; });
$("reset").addEventListener("click", () => { for (const one of sliders) one.put(one.found); redraw(); });
$("run").addEventListener("change", redraw);
$("latex").addEventListener("click", async () => {
  await navigator.clipboard.writeText(parts.found.latex).catch(() => {});
  $("latex").textContent = "Copied";
  setTimeout(() => { $("latex").textContent = "Copy LaTeX"; }, 1500);
});
listen();
