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
const ROLES = { time: "time", state: "state", input: "input", sum: "sum of states", error: "errors of a state", dose: "doses of a state", trajectory: "names the run", quantity: "names the quantity", unused: "not used" };
const isMeasured = column => ["state", "sum"].includes(column.role);
const HOLDS = { previous: "keeps its value between rows", linear: "straight between rows", smooth: "smooth between rows" };

// What a reader has to know of the fields of a column, where there are any.
const HELP = {
  error: "error: how far values are from the truth, as your instrument says: a number in the unit of the column, or a per cent. Empty: the data show it.",
  limit: "limit: cells without a number, such as BDL, say that the value is below it. Without the limit they count as empty.",
  errors: "errors of a state: standard deviations say how large errors are; ratios say only how they differ from row to row.",
  sum: "sum of states: the column is the sum of states, such as S + I, of which one has no column of its own.",
};
const field = (column, j, name, given, ask) => {
  const made = make("input", { id: `${name}-${j}`, value: column[name], maxLength: 80, ...given });
  made.addEventListener("change", async () => {
    if (!await mayLose("Change the column")) { made.value = column[name]; return; }
    column[name] = made.value.trim();
    ask();
  });
  return made;
};
const showTable = table => {
  show("table", table);
  if (!table) return;
  $("guess").textContent = table.error || table.guess;
  $("guess").className = table.error ? "bad" : "";
  list("notes", [...table.loaded, ...table.notes.filter(note => !table.loaded.includes(note))]);
  const focused = document.activeElement && document.activeElement.id;
  const changed = () => {
    const said = kind => Object.fromEntries(table.columns.map(column => [column.name, column[kind]]));
    post("columns", { roles: said("role"), units: said("unit"), ways: said("way"), errors: said("error"), limits: said("limit") });
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
    const fields = [];
    if (!["unused", "trajectory", "quantity", "dose", "error"].includes(column.role))
      fields.push(field(column, j, "unit", { placeholder: "unit", ariaLabel: `Unit of ${column.name}` }, changed));
    const measured = isMeasured(column) && column.own;
    // Errors that are in a column are said there.
    const apart = table.columns.some(other => other.role === "error" && other.way.replace(/\*$/, "") === column.name);
    if (measured && !apart) fields.push(field(column, j, "error", { placeholder: "error: 0.1 or 5 %", ariaLabel: `Known error of ${column.name}` }, changed));
    if (measured && column.open) fields.push(field(column, j, "limit", { placeholder: "limit", ariaLabel: `Limit of ${column.name}` }, changed));
    if (column.role === "sum") fields.push(field(column, j, "way", { placeholder: "S + I", ariaLabel: `States whose sum is ${column.name}` }, changed));
    const states = table.columns.filter(isMeasured);
    const ways = {
      input: Object.entries(HOLDS),
      dose: states.flatMap(other => [
        [other.name, `added to ${other.name}`],
        [`${other.name}/V`, `divided by a volume V that is fitted, added to ${other.name}`],
      ]),
      error: states.flatMap(other => [
        ...(column.called === other.name ? [[`${other.name}*`, `ratios, of ${other.name}`]] : []),
        [other.name, `standard deviations, of ${other.name}`],
      ]),
    }[column.role] || [];
    const what = { dose: "State of the doses", error: "State of the errors" }[column.role] || "Between rows";
    const way = make("select", { id: `way-${j}`, className: "way", ariaLabel: `${what}: ${column.name}` },
      ...ways.map(([value, words]) => make("option", { value, selected: value === column.way }, words)));
    way.addEventListener("change", async () => {
      if (!await mayLose("Change the column")) { way.value = column.way; return; }
      column.way = way.value;
      changed();
    });
    return make("th", { className: column.role, scope: "col" }, column.name, role, ...fields, ...(ways.length ? [way] : []));
  });
  $("columns").tHead.replaceChildren(make("tr", {}, ...heads));
  const count = Math.max(0, ...table.columns.map(column => column.cells.length));
  $("columns").tBodies[0].replaceChildren(...Array.from({ length: count }, (_, i) =>
    make("tr", {}, ...table.columns.map(column => make("td", { className: column.role }, column.cells[i])))));
  $("rows").textContent = `The first ${count} of ${table.rows} rows.` + (table.hidden ? ` ${table.hidden} more columns are not shown, and not used once a role is changed.` : "");
  const measured = table.columns.filter(column => isMeasured(column) && column.own);
  list("help", [
    ...(measured.length ? [HELP.error] : []),
    ...(measured.some(column => column.open) ? [HELP.limit] : []),
    ...(table.columns.some(column => column.role === "error") ? [HELP.errors] : []),
    ...(measured.some(column => column.role === "sum") ? [HELP.sum] : []),
  ]);
  showVary(table);
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
// With one run there is nothing that could differ.
const showVary = table => {
  const choice = document.forms.options.elements.vary, before = choice.value;
  show("vary", table.runs > 1);
  const some = table.states.length > 1 ? table.states.map(state => [state, `some in the equation of ${state} may differ`]) : [];
  choice.replaceChildren(...[["", "all constants are shared"], ["*", "some constants may differ"], ...some].map(([value, words]) => make("option", { value }, words)));
  choice.value = table.runs > 1 && [...choice.options].some(one => one.value === before) ? before : "";
};
const readOptions = () => {
  const form = $("options"), options = {};
  for (const name of ["scheme", "time_budget", "max_complexity", "terms", "conserved", "seed", "vary", "hidden", "delays"]) {
    const value = form.elements[name].value.trim();
    if (value) options[name] = value;
  }
  if (options.delays === "about") options.delays = form.elements.delay.value.trim() || "*";
  options.stochastic = form.elements.stochastic.value === "yes";
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
  for (const id of ["by-run", "noise"]) show(id, false);
  clearTimeout(waiting);
  waiting = 0;
  asked = null;
  if (!found) { sliders = []; show("constants", false); return; }
  $("verdict").textContent = found.complete ? found.heading : "Cancelled. These are the best equations so far, without a verdict.";
  $("verdict").className = `banner ${level(found.level)}`;
  list("said-found", found.notes);
  $("equations").replaceChildren(...found.equations.map(one => card(one, one.level, one.why)));
  $("python").textContent = found.python;
  list("facts", found.facts);
  $("moving").textContent = found.moving.join(" ");
  show("by-run", found.by_run);
  if (found.by_run) {
    const [head, body] = [$("by-run").querySelector("thead"), $("by-run").querySelector("tbody")];
    head.replaceChildren(make("tr", {}, ...found.by_run.head.map(name => make("th", { scope: "col" }, name))));
    body.replaceChildren(...found.by_run.rows.map(row => make("tr", {}, ...row.map(cell => make("td", {}, cell)))));
    $("by-run-note").textContent = found.by_run.note;
  }
  show("noise", found.noise.length);
  list("noise-notes", found.noise);
  $("steps").innerHTML = found.steps;
  list("points", found.points);
  $("flow").innerHTML = found.flow;
  $("branches").innerHTML = found.branches ? found.branches.svg : "";
  $("branches-words").textContent = found.branches ? found.branches.caption : "";
  $("exports").replaceChildren(...found.exports.map(one => make("a", { className: "button", href: one.file, download: "" }, one.title)));
  sliders = found.constants.map(one => slider(one, found.left, found.units));
  // A sign, or the factor of a hidden state, was chosen and not fitted.
  const movable = sliders.filter((_, i) => !found.constants[i].fixed).flatMap(one => one.rows);
  $("rows-of-constants").replaceChildren(...movable);
  show("constants", movable.length || found.moving.length);
  for (const one of document.querySelectorAll("#constants > :is(.scroll, .hint)")) one.hidden = !movable.length;
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
document.forms.options.elements.delays.addEventListener("change", event => {
  document.forms.options.elements.delay.hidden = event.target.value !== "about";
});
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
