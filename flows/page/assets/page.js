"use strict";
// The page's own script: token, sentences, news, the live force, dropped files, tables. State is on the server.
(() => {
  const meta = (name) => document.querySelector(`meta[name="${name}"]`)?.content ?? "";
  const token = meta("fast-token");
  let campaign = meta("fast-campaign");
  const $ = (selector, root = document) => root.querySelector(selector);

  // A number as reports write it: no minus before a zero, and the sign that is as wide as the plus.
  const tenths = (value) => (Math.round(10 * value) / 10 + 0).toFixed(1).replace("-", "\u2212");

  // What was done, or why not.
  let quiet;
  function say(words, isWrong = false) {
    const place = $("#said");
    place.textContent = words;
    place.classList.toggle("wrong", isWrong);
    place.hidden = false;
    clearTimeout(quiet);
    if (!isWrong) quiet = setTimeout(() => { place.hidden = true; }, 9000);
  }
  document.addEventListener("htmx:configRequest", (event) => { event.detail.headers["X-Fast-Token"] = token; });
  document.addEventListener("said", (event) => { say(event.detail.value ?? ""); });
  document.addEventListener("htmx:responseError", (event) => { say(event.detail.xhr.responseText, true); tell("changed"); });
  document.addEventListener("htmx:sendError", (event) => { if (event.detail.requestConfig.verb !== "get") say("The page's server does not answer; nothing was changed.", true); });
  const tell = (name) => document.body.dispatchEvent(new CustomEvent(name));

  // What is sent twice, by a double click, is sent once. A question before what cannot be taken back is asked once.
  const sent = new WeakSet();
  document.addEventListener("htmx:beforeRequest", (event) => { if (event.detail.requestConfig.verb !== "get") sent.add(event.detail.elt); });
  document.addEventListener("htmx:afterRequest", (event) => { sent.delete(event.detail.elt); });
  document.addEventListener("htmx:confirm", (event) => {
    if (sent.has(event.detail.elt)) event.preventDefault();
    if (!event.detail.question) return;
    event.preventDefault();
    const dialog = $("#ask"), yes = $("#ask-yes");
    $("#ask-words").textContent = event.detail.question;
    yes.textContent = event.detail.elt.dataset.yes ?? "Yes";
    yes.onclick = () => { dialog.close(); event.detail.issueRequest(true); };
    $("#ask-no").onclick = () => dialog.close();
    dialog.showModal();
  });
  document.addEventListener("change", (event) => { if (event.target.matches("[data-submits]")) event.target.form.submit(); });

  // What somebody fills in stays when the part around it is drawn anew, until it was sent and taken.
  const touch = (element) => element.closest("[data-keep]")?.setAttribute("data-touched", "");
  const leave = (element) => element.closest("[data-keep]")?.removeAttribute("data-touched");
  document.addEventListener("input", (event) => touch(event.target));
  document.addEventListener("click", (event) => { if (event.target.closest("summary")) touch(event.target); });
  document.addEventListener("htmx:beforeOnLoad", (event) => { if (event.detail.requestConfig.verb !== "get" && event.detail.xhr.status < 400) leave(event.detail.elt); });
  let kept = [];
  document.addEventListener("htmx:beforeSwap", (event) => { kept = event.detail.shouldSwap ? [...event.detail.target.querySelectorAll("[data-touched]")].map((old) => [old, old.contains(document.activeElement) && document.activeElement]) : []; });
  document.addEventListener("htmx:afterSwap", () => {
    for (const [old, active] of kept.splice(0)) {
      const fresh = $(`[data-keep="${CSS.escape(old.dataset.keep)}"]`);
      if (fresh) fresh.replaceWith(old);
      else if (old.matches(".todo")) $("#todos")?.prepend(old); // somebody else did it: sending it says so
      htmx.process(old);
      if (active) active.focus();
    }
  });

  // News.
  const longestSilenceMs = 40000;  // the server says something every 15 s: a hung one, or a lost network, does not
  let source, newsAt = 0, heardAt = Date.now();
  function listen() {
    if (!campaign || document.hidden) return;
    source = new EventSource(`/events?campaign=${encodeURIComponent(campaign)}`);
    heardAt = Date.now();
    for (const kind of ["ping", "standing", "news", "force"]) source.addEventListener(kind, () => { heardAt = Date.now(); });
    source.onopen = () => { if (!$("#lost").hidden) { $("#lost").hidden = $("#said").hidden = true; tell("standing"); tell("news"); } };
    source.onerror = () => { $("#lost").hidden = false; };
    source.addEventListener("standing", () => { tell("standing"); count(); });
    source.addEventListener("news", () => {
      const wait = Math.max(0, newsAt + 2000 - Date.now());
      if (wait === 0) { newsAt = Date.now(); tell("news"); count(); } else if (newsAt < Date.now()) { newsAt += 2000; setTimeout(() => { tell("news"); count(); }, wait); }
    });
    source.addEventListener("force", (event) => { take(JSON.parse(event.data)); });
  }
  async function count() {
    try {
      const answer = await fetch("/api/v1/todo");
      if (!answer.ok) return;
      const n = (await answer.json()).length, badge = $("#n-todos");
      if (badge && badge.textContent !== String(n)) { badge.textContent = n; badge.classList.toggle("none", n === 0); tell("changed"); }
    } catch { /* the next news tells */ }
  }
  document.addEventListener("htmx:afterSettle", () => {  // the first campaign of a lake that had none when the page was opened
    if (campaign || !$("#strip").dataset.campaign) return;
    if (!$("#config")) { location.reload(); return; }  // a config that is being written stays
    campaign = $("#strip").dataset.campaign;
    listen(); count();
  });
  setInterval(() => {
    if (source && Date.now() - heardAt > longestSilenceMs) { $("#lost").hidden = false; source.close(); listen(); }
  }, 2000);
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) { source?.close(); source = undefined; } else if (!source) { listen(); tell("standing"); tell("news"); }
  });

  // The force of the present grasp.
  let live = { lift: [], force: [] }, before = { lift: [], force: [] }, simulated = { lift_mm: [], force_n: [] }, plot, isDue = false;
  function take(part) {
    const place = $("#live");
    if (part.isOther) {
      if (live.force.length > 20) before = live;
      live = { lift: [], force: [] };
      fetchSimulated(part);
      const what = part.purpose ? part.purpose.replaceAll("_", " ") : `repeat ${part.repeat}`;
      if ($("#live-title")) $("#live-title").textContent = `${part.tool.split("/").pop()} on ${part.name}, ${what}`;
      mark(part);
    }
    for (let i = 0; i < part.force.length; i++) {
      const last = live.lift.length ? live.lift[live.lift.length - 1] : 0;
      live.lift.push(Math.max(part.lift[i], last));
      live.force.push(part.force[i]);
    }
    if (part.force.length && $("#live-force")) $("#live-force").textContent = `${tenths(part.force[part.force.length - 1])} N`;
    if (place && !isDue) { isDue = true; requestAnimationFrame(() => { isDue = false; draw(place); }); }
  }
  let simulatedOf = "";
  async function fetchSimulated(part) {
    const key = `${part.tool} ${part.object}`;
    if (key === simulatedOf || !$("#live")) return;
    simulatedOf = key;
    simulated = { lift_mm: [], force_n: [] };
    const query = new URLSearchParams({ campaign, tool: part.tool, object: part.object });
    const answer = await fetch(`/now/simulated?${query}`);
    if (answer.ok && simulatedOf === key) { simulated = await answer.json(); if ($("#live")) draw($("#live")); }
  }
  function mark(part) {
    for (const old of document.querySelectorAll(".map .here")) old.classList.remove("here");
    $(`.map .place[data-object="${part.object}"]`)?.classList.add("here");
    $(`.map .slot[data-tool="${CSS.escape(part.tool.split("/").pop())}"]`)?.classList.add("here");
    live.part = part;
  }
  document.addEventListener("htmx:afterSettle", () => { if (live.part) mark(live.part); });

  // A place or slot of the map that is clicked is chosen in the form below it.
  document.addEventListener("click", (event) => {
    const one = event.target.closest?.(".map .place, .map .slot"), form = $("#leave-out");
    if (!one || !form) return;
    const choice = one.dataset.object ? `[data-object="${one.dataset.object}"]` : `[data-slot="${one.dataset.slot}"]`;
    const option = form.querySelector(`option${choice}`);
    if (!option) return;
    form.open = true;
    option.selected = true;
    form.querySelector("[name=reason]").focus();
  });

  // uPlot wants one x for all lines, each value once.
  function series(lift, force) {
    const x = [], y = [];
    for (let i = 0; i < lift.length; i++) {
      if (x.length && lift[i] <= x[x.length - 1]) { if (Math.abs(force[i]) > Math.abs(y[y.length - 1]) || lift[i] < 0.01) y[y.length - 1] = force[i]; } else { x.push(lift[i]); y.push(force[i]); }
    }
    return [x, y];
  }
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  function options(place, lines) {
    const axis = { stroke: colour("--muted"), grid: { stroke: colour("--line"), width: 0.6 }, ticks: { stroke: colour("--line") }, font: "13px system-ui" };
    return {
      width: place.clientWidth, height: Math.max(220, Math.min(360, place.clientWidth * 0.62)), cursor: { y: false }, legend: { show: false },
      scales: { x: { time: false, range: (_u, _low, high) => [0, Math.max(high ?? 0, 10)] }, y: { range: (_u, low, high) => [Math.min(0, low ?? 0), Math.max(5, (high ?? 0) * 1.08)] } },
      axes: [{ ...axis, label: "lift, mm", labelSize: 20, size: 36 }, { ...axis, label: "force, N", labelSize: 20, size: 44 }], series: [{}, ...lines],
    };
  }
  function draw(place) {
    place.dataset.lift = live.lift.length ? live.lift[live.lift.length - 1] : 0;
    const data = uPlot.join([series(live.lift, live.force), series(simulated.lift_mm, simulated.force_n), series(before.lift, before.force)]);
    if (plot && plot.root.isConnected) { plot.setData(data); return; }
    plot = new uPlot(options(place, [{ label: "measured", stroke: colour("--now"), width: 2, spanGaps: true }, { label: "simulated", stroke: colour("--sim"), width: 2, dash: [6, 4], spanGaps: true }, { label: "the grasp before", stroke: colour("--line"), width: 1.5, spanGaps: true }]), data, place);
  }
  window.addEventListener("resize", () => { if (plot && $("#live")) { plot.destroy(); plot = undefined; draw($("#live")); } drawAll(true); });

  // Traces of the lake laid over each other: the numbers stand in the page.
  const palette = ["--now", "--done", "--sim", "--strange", "--warn", "--muted"];
  function drawAll(isAgain = false) {
    for (const place of document.querySelectorAll("[data-traces]")) {
      if (place.dataset.drawn && !isAgain) continue;
      place.replaceChildren();
      place.dataset.drawn = "yes";
      const traces = JSON.parse(place.dataset.traces);
      if (!traces.length) continue;
      const lines = traces.map((trace) => ({ label: trace.label, stroke: colour(palette[trace.colour % palette.length]), width: trace.simulated ? 2 : 1.6, dash: trace.simulated ? [6, 4] : undefined, spanGaps: true }));
      new uPlot(options(place, lines), uPlot.join(traces.map((trace) => series(trace.lift, trace.force))), place);
    }
    for (const place of document.querySelectorAll("[data-points]")) {
      if (place.dataset.drawn && !isAgain) continue;
      place.replaceChildren();
      place.dataset.drawn = "yes";
      const found = JSON.parse(place.dataset.points), order = found.x.map((_, i) => i).sort((a, b) => found.x[a] - found.x[b]);
      const set = options(place, [{ label: found.yName, stroke: colour("--done"), width: 0, points: { show: true, size: 6, fill: colour("--done") } }]);
      set.scales = { x: { time: false } };
      set.axes[0].label = found.xName;
      set.axes[1].label = found.yName;
      new uPlot(set, [order.map((i) => found.x[i]), order.map((i) => found.y[i])], place);
    }
  }
  document.addEventListener("htmx:afterSettle", () => drawAll());

  // Files that are dropped: sent as they are, looked at on the server.
  async function send(place, file) {
    const shown = place.parentElement.querySelector(".dropped");
    touch(place);
    $("#said").hidden = true;
    shown.textContent = `${file.name} is looked at ...`;
    const query = new URLSearchParams({ campaign: place.dataset.drop, name: file.name });
    try {
      const answer = await fetch(`/todo/told/look?${query}`, { method: "POST", body: file, headers: { "X-Fast-Token": token, "Content-Type": "application/octet-stream" } });
      if (!answer.ok) { shown.textContent = ""; say(await answer.text(), true); return; }
      shown.innerHTML = await answer.text(); // escaped by the server's templates
      htmx.process(shown);
    } catch { shown.textContent = ""; say("The page's server does not answer; nothing was written.", true); }
  }
  document.addEventListener("change", (event) => {
    const place = event.target.closest?.("[data-drop]");
    if (place && event.target.files?.length) { send(place, event.target.files[0]); event.target.value = ""; }
  });
  for (const kind of ["dragover", "dragleave", "drop"]) {
    document.addEventListener(kind, (event) => {
      const place = event.target.closest?.("[data-drop]");
      if (kind !== "dragleave") event.preventDefault();
      if (!place) return;
      place.classList.toggle("over", kind === "dragover");
      if (kind === "drop" && event.dataTransfer.files.length) send(place, event.dataTransfer.files[0]);
    });
  }
  document.addEventListener("change", async (event) => {
    const file = event.target.files?.[0];
    if (file && event.target.matches("[data-photo]")) {
      const answer = await fetch(`/results/photo?${new URLSearchParams({ about: event.target.dataset.photo })}`, { method: "POST", body: file, headers: { "X-Fast-Token": token, "Content-Type": "application/octet-stream" } });
      if (answer.ok) location.reload(); else say(await answer.text(), true);
    }
    if (file && event.target.matches("[data-config]")) {
      const text = $("#config");
      text.value = await file.text();
      text.dispatchEvent(new Event("input", { bubbles: true }));
    }
  });
  document.addEventListener("click", (event) => {
    if (event.target.matches("[data-forget]")) { leave(event.target); event.target.closest(".dropped").replaceChildren(); }
    const head = event.target.closest("th button[data-sort]");
    if (head) sort(head);
  });

  // Tables that sort and filter.
  function sort(button) {
    const head = button.closest("th"), table = head.closest("table"), body = table.tBodies[0], place = head.cellIndex;
    const isDown = head.getAttribute("aria-sort") !== "descending";
    for (const other of table.querySelectorAll("th")) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", isDown ? "descending" : "ascending");
    const value = (row) => row.cells[place].dataset.value ?? row.cells[place].textContent.trim();
    const rows = [...body.rows].map((row) => [value(row), row]);
    const number = (text) => (text === "" ? -Infinity : Number(text));
    const isNumeric = rows.every(([text]) => text === "" || !Number.isNaN(Number(text)));
    rows.sort(([a], [b]) => { const order = isNumeric ? (number(a) - number(b) || 0) : a.localeCompare(b, undefined, { numeric: true }); return isDown ? -order : order; });
    body.append(...rows.map(([, row]) => row));
  }
  document.addEventListener("input", (event) => {
    if (!event.target.matches("[data-filters]")) return;
    const words = event.target.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of document.getElementById(event.target.dataset.filters).tBodies[0].rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
    }
  });

  // The bench by hand: what it reads, as long as its card is on the screen; drawn anew when another has it.
  async function readBench() {
    const card = $("#by-hand");
    if (!card || document.hidden) return;
    try {
      const answer = await fetch("/bench/reading");
      if (!answer.ok) return;
      const now = await answer.json(), isThere = now.z_mm !== undefined;
      if (now.mark !== card.dataset.mark) { tell("bench"); return; }
      $("#bench-said").textContent = now.said;
      $("#bench-said").hidden = !now.said;
      if (!$("#bench-steps")) return;
      $("#bench-place").textContent = isThere ? `x ${tenths(now.x_mm)}, y ${tenths(now.y_mm)}, z ${tenths(now.z_mm)} mm` : "not connected yet";
      $("#bench-force").textContent = isThere ? `${tenths(now.force_n)} N` : "";
      $("#bench-grip").textContent = isThere ? `${now.is_gripping ? "closed" : "open"}${now.pressure_psi === null ? "" : `, ${now.pressure_psi.toFixed(0)} psi`}; ${now.has_tool ? "a tool" : "no tool"} on the head` : "";
      for (const button of card.querySelectorAll("#bench-steps button")) button.disabled = !isThere;
      $("#bench-fault").textContent = now.fault ?? "";
      $("#bench-fault").hidden = !now.fault;
      $("#bench-recover").hidden = !now.fault;
    } catch { /* the next look tells */ }
  }
  if ($("#by-hand")) {
    const look = () => { readBench().finally(() => setTimeout(look, $("#bench-steps") ? 250 : 1500)); };
    look();
  }

  // Links for others begin as this page does: before its server may stand a proxy with TLS.
  for (const link of document.querySelectorAll("[data-link]")) link.textContent = location.origin + link.textContent.slice(new URL(link.textContent).origin.length);

  listen();
  drawAll();
})();
