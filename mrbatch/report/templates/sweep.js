(function () {
  "use strict";
  var box = document.getElementById("comparer");
  if (!box) return;
  var panes = box.querySelectorAll(".pane");
  var thumbs = box.querySelectorAll(".thumbs button");
  var selects = box.querySelectorAll("select");
  var state = { mode: "flip", shown: 1, zoom: 1, x: 0, y: 0, error: false, timer: 0, drag: null };

  function source(name) {
    for (var i = 0; i < thumbs.length; i += 1) if (thumbs[i].dataset.name === name) return thumbs[i];
    return thumbs[0];
  }
  function draw() {
    box.dataset.mode = state.mode;
    panes.forEach(function (pane, i) {
      var from = source(selects[i].value);
      var address = state.error && from.dataset.error ? from.dataset.error : from.querySelector("img").src;
      var img = pane.querySelector("img");
      if (img.src !== address) img.src = address;
      img.style.transform = "translate(" + state.x + "%," + state.y + "%) scale(" + state.zoom + ")";
      pane.querySelector(".what").textContent = "AB"[i] + ": " + from.dataset.words;
      pane.classList.toggle("hidden", state.mode === "flip" && i !== state.shown);
      pane.classList.toggle("mapped", state.error && !!from.dataset.error);
    });
    thumbs.forEach(function (thumb) {
      thumb.classList.toggle("a", thumb.dataset.name === selects[0].value);
      thumb.classList.toggle("b", thumb.dataset.name === selects[1].value);
    });
    box.querySelectorAll("[data-mode]").forEach(function (b) {
      b.setAttribute("aria-pressed", String(b.dataset.mode === state.mode));
    });
    box.querySelector("[data-do=error]").setAttribute("aria-pressed", String(state.error));
    box.querySelector("[data-do=auto]").setAttribute("aria-pressed", String(!!state.timer));
    box.querySelector(".zoomed").textContent = Math.round(state.zoom * 100) + " %";
  }
  function limit() {
    var most = 50 * (state.zoom - 1);
    state.x = Math.max(-most, Math.min(most, state.x));
    state.y = Math.max(-most, Math.min(most, state.y));
  }
  function zoom(factor) {
    var to = Math.max(1, Math.min(16, state.zoom * factor));
    state.x *= to / state.zoom; state.y *= to / state.zoom; state.zoom = to;
    limit(); draw();
  }
  function flip() { state.shown = 1 - state.shown; draw(); }
  function auto(on) {
    clearInterval(state.timer); state.timer = on ? setInterval(flip, 700) : 0;
    if (on) state.mode = "flip";
    draw();
  }
  var doing = {
    flip: function () { state.mode = "flip"; flip(); },
    auto: function () { auto(!state.timer); },
    error: function () { state.error = !state.error; draw(); },
    closer: function () { zoom(1.6); },
    wider: function () { zoom(1 / 1.6); },
    whole: function () { state.zoom = 1; state.x = state.y = 0; draw(); }
  };
  box.addEventListener("click", function (event) {
    var button = event.target.closest("button");
    if (!button) return;
    if (button.dataset.mode) { auto(false); state.mode = button.dataset.mode; draw(); }
    else if (button.dataset.do) doing[button.dataset.do]();
    else if (button.dataset.name) { selects[1].value = button.dataset.name; state.shown = 1; draw(); }
  });
  selects.forEach(function (select, i) {
    select.addEventListener("change", function () { state.shown = i; draw(); });
  });
  box.querySelector("input[type=range]").addEventListener("input", function (event) {
    var stops = Number(event.target.value);
    box.querySelector(".stops").textContent = (stops > 0 ? "+" : "") + stops.toFixed(1) + " stops";
    document.querySelectorAll("#exposure [slope]").forEach(function (f) { f.setAttribute("slope", Math.pow(2, stops)); });
  });
  panes.forEach(function (pane) {
    pane.addEventListener("wheel", function (event) {
      event.preventDefault(); zoom(event.deltaY < 0 ? 1.15 : 1 / 1.15);
    }, { passive: false });
    pane.addEventListener("pointerdown", function (event) {
      state.drag = [event.clientX, event.clientY, 0]; pane.setPointerCapture(event.pointerId);
    });
    pane.addEventListener("pointermove", function (event) {
      if (!state.drag) return;
      var dx = event.clientX - state.drag[0], dy = event.clientY - state.drag[1];
      state.x += 100 * dx / pane.clientWidth; state.y += 100 * dy / pane.clientHeight;
      state.drag = [event.clientX, event.clientY, state.drag[2] + Math.abs(dx) + Math.abs(dy)];
      limit(); draw();
    });
    pane.addEventListener("pointerup", function () {
      if (state.drag && state.drag[2] < 4 && state.mode === "flip") flip();
      state.drag = null;
    });
    pane.addEventListener("pointercancel", function () { state.drag = null; });
  });
  box.addEventListener("keydown", function (event) {
    if (/^(SELECT|INPUT|BUTTON)$/.test(event.target.tagName)) return;
    var keys = { " ": "flip", e: "error", "+": "closer", "-": "wider", "0": "whole" };
    if (keys[event.key]) { event.preventDefault(); doing[keys[event.key]](); }
  });
  box.classList.add("live");
  draw();
})();
