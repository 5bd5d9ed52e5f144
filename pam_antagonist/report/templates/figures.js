// Draws a report's figures: on sight, linked in time, in the colours of the reader's theme, and fit for fingers.
(async function () {
  "use strict";
  const plots = Array.from(document.querySelectorAll(".plot"));
  const drawn = [];
  const fingers = window.matchMedia("(pointer: coarse)").matches;
  const scheme = window.matchMedia("(prefers-color-scheme: dark)");
  const darkColors = JSON.parse(document.getElementById("dark-colors").textContent);
  let printing = false;
  let busy = false;

  // Library and data are gzip in base64.
  function unpack(id) {
    const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }

  // The data have the colours of the light theme, and paper is always light.
  function colored(text) {
    if (printing || !scheme.matches) { return text; }
    return text.replace(/"(#[0-9a-f]{6}|rgba\([^"]*\))"/g, (whole, color) => `"${darkColors[color] || color}"`);
  }

  function axesOf(layout, pattern) {
    return Object.keys(layout).filter((key) => pattern.test(key));
  }

  function timeAxes(layout) {
    return axesOf(layout, /^xaxis[0-9]*$/).filter((key) => layout[key].meta === "time");
  }

  // A zoom in one figure's time is a zoom in that of every figure of the same recording.
  function follow(source, event) {
    if (busy) { return; }
    const key = Object.keys(event).find((k) => /^xaxis[0-9]*\.(range|autorange)/.test(k));
    const shown = key && source.layout[key.split(".")[0]];
    if (!shown || shown.meta !== "time") { return; }
    const range = shown.autorange ? null : shown.range.slice();
    busy = true;
    const others = drawn.filter((other) => other !== source && other.dataset.link === source.dataset.link);
    const todo = others.map((other) => {
      const change = {};
      timeAxes(other.layout).forEach((name) => {
        if (range) { change[name + ".range"] = range; } else { change[name + ".autorange"] = true; }
      });
      return Object.keys(change).length ? Plotly.relayout(other, change) : null;
    });
    const free = () => { busy = false; };
    Promise.all(todo).then(free, free);
  }

  // On a phone a long legend has rows of its own; it takes no height from the curves.
  function fit(plot) {
    const narrow = plot.clientWidth < 560;
    const layout = plot.layout;
    const rows = narrow ? Math.max(Math.ceil(Number(plot.dataset.named) / 2) - 1, 0) : 0;
    layout.width = plot.clientWidth;
    layout.height = Number(plot.dataset.height) + 19 * rows;
    plot.style.height = layout.height + "px";
    layout.margin.l = narrow ? 54 : 66;
    layout.font.size = narrow ? 11 : 12;
  }

  // Always light, for papers and slides; as far zoomed as it is seen.
  function save(plot) {
    const figure = JSON.parse(plot.source);
    axesOf(plot.layout, /^[xy]axis/).forEach((key) => { figure.layout[key].range = plot.layout[key].range.slice(); });
    const name = plot.getAttribute("aria-label").replace(/[^\p{L}\p{N}]+/gu, "_");
    Plotly.downloadImage(figure, { format: "svg", width: plot.clientWidth, height: plot.clientHeight, filename: name });
  }

  // Two fingers stretch the axis between them, one moves what is stretched, a double tap goes back. A finger that
  // moves up or down scrolls the page: the browser keeps that to itself (touch-action).
  function touchable(plot) {
    const fingersDown = new Map();
    let start = null;
    let tapped = 0;

    function axisAt(x) {
      const inside = x - plot.getBoundingClientRect().left;
      return axesOf(plot.layout, /^xaxis[0-9]*$/).map((name) => plot._fullLayout[name]).find((axis) =>
        !axis.fixedrange && inside >= axis._offset - 20 && inside <= axis._offset + axis._length + 20);
    }

    function places() {
      const left = plot.getBoundingClientRect().left + start.axis._offset;
      return Array.from(fingersDown.values(), (x) => (x - left) / start.axis._length);
    }

    function begin() {
      const middle = Array.from(fingersDown.values()).reduce((sum, x) => sum + x, 0) / fingersDown.size;
      const axis = fingersDown.size && axisAt(middle);
      start = axis ? { axis: axis, range: axis.range.slice(), moved: false } : null;
      if (start) { start.places = places(); }
    }

    function move() {
      const now = places();
      const [low, high] = start.range;
      const at = start.places.map((place) => low + place * (high - low));
      let width = high - low;
      if (now.length > 1) { width = (at[1] - at[0]) / (now[1] - now[0]); }
      if (!(width / (high - low) > 1e-3)) { return; }
      const first = at[0] - now[0] * width;
      busy = true;
      const free = () => { busy = false; };
      Plotly.relayout(plot, { [start.axis._name + ".range"]: [first, first + width] }).then(free, free);
    }

    plot.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "touch" || !plot._fullLayout) { return; }
      plot.setPointerCapture(event.pointerId);  // what is under the finger is drawn again while it moves
      fingersDown.set(event.pointerId, event.clientX);
      begin();
    });
    plot.addEventListener("pointermove", (event) => {
      if (!fingersDown.has(event.pointerId)) { return; }
      fingersDown.set(event.pointerId, event.clientX);
      const zoomed = start && plot.layout[start.axis._name].autorange === false;
      if (start && !busy && (zoomed || fingersDown.size > 1)) { start.moved = true; move(); }
    });
    plot.addEventListener("touchmove", (event) => {
      if (event.touches.length > 1 && event.cancelable) { event.preventDefault(); }
    }, { passive: false });
    ["pointerup", "pointercancel"].forEach((kind) => plot.addEventListener(kind, (event) => {
      if (!fingersDown.delete(event.pointerId)) { return; }
      const name = start && start.axis._name;
      if (start && start.moved) {
        setTimeout(() => follow(plot, { [name + ".range"]: true }), 50);
      } else if (name && kind === "pointerup" && fingersDown.size === 0) {
        if (event.timeStamp - tapped < 350) { Plotly.relayout(plot, { [name + ".autorange"]: true }); }
        tapped = event.timeStamp;
      }
      begin();
    }));
  }

  function show(plot) {
    const figure = JSON.parse(colored(plot.source));
    const before = plot.layout;
    plot.dataset.height = figure.layout.height;
    plot.dataset.named = new Set(figure.data.filter((trace) => trace.showlegend).map((trace) => trace.name)).size;
    plot.layout = figure.layout;
    fit(plot);
    // What was zoomed stays so when the colours change.
    axesOf(before || {}, /^[xy]axis/).filter((key) => before[key].autorange === false).forEach((key) => {
      figure.layout[key].range = before[key].range.slice();
    });
    figure.layout.dragmode = fingers ? false : "zoom";
    const svg = { name: "svg", title: "Save as SVG", icon: Plotly.Icons.camera, click: save };
    return Plotly.newPlot(plot, figure.data, figure.layout, {
      displaylogo: false, displayModeBar: fingers ? false : "hover",
      modeBarButtons: [["zoomIn2d", "zoomOut2d", "resetScale2d", "zoom2d", "pan2d", svg]]
    }).then(() => { plot.on("plotly_relayout", (event) => follow(plot, event)); });
  }

  function draw(plot) {
    if (plot.classList.contains("drawn")) { return; }
    plot.classList.add("drawn");
    if (fingers) { touchable(plot); }
    show(plot).then(() => {
      const leader = drawn.find((other) => other.dataset.link === plot.dataset.link);
      drawn.push(plot);
      const axis = leader && timeAxes(leader.layout)[0];
      if (axis && leader.layout[axis].autorange === false) { follow(leader, { [axis + ".range"]: true }); }
    });
  }

  function recolor() { drawn.forEach(show); }

  if (!("DecompressionStream" in window)) {
    plots.forEach((plot) => { plot.textContent = "This browser is too old to draw the figures."; });
    return;
  }
  const library = document.createElement("script");
  library.textContent = await unpack("plotly");
  document.body.appendChild(library);
  await Promise.all(plots.map(async (plot) => { plot.source = await unpack(plot.id + "-data"); }));

  const watcher = new IntersectionObserver((entries) => {
    entries.filter((entry) => entry.isIntersecting).forEach((entry) => {
      watcher.unobserve(entry.target);
      draw(entry.target);
    });
  }, { rootMargin: "600px" });
  // The container, not the window, decides about the width: a fold, a print preview or a turned phone changes it too.
  const fitter = new ResizeObserver((entries) => {
    entries.map((entry) => entry.target).forEach((plot) => {
      if (!plot._fullLayout || plot.clientWidth === 0 || Math.abs(plot._fullLayout.width - plot.clientWidth) <= 1) { return; }
      fit(plot);
      Plotly.relayout(plot, {
        width: plot.layout.width, height: plot.layout.height, margin: plot.layout.margin,
        "font.size": plot.layout.font.size
      });
    });
  });
  plots.forEach((plot) => { watcher.observe(plot); fitter.observe(plot); });

  // A table that does not fit says so.
  const measure = new ResizeObserver((entries) => {
    entries.map((entry) => entry.target).forEach((box) => {
      const told = box.previousElementSibling && box.previousElementSibling.classList.contains("more");
      if (box.scrollWidth > box.clientWidth + 1 && !told) {
        const more = document.createElement("p");
        more.className = "more";
        more.textContent = "the table goes on to the right →";
        box.before(more);
      } else if (box.scrollWidth <= box.clientWidth + 1 && told) {
        box.previousElementSibling.remove();
      }
    });
  });
  document.querySelectorAll(".scroll").forEach((box) => { measure.observe(box); });
  scheme.addEventListener("change", recolor);
  window.addEventListener("beforeprint", () => {
    printing = true;
    document.querySelectorAll("details").forEach((item) => { item.open = true; });
    if (scheme.matches) { recolor(); }
    plots.forEach(draw);
  });
  window.addEventListener("afterprint", () => {
    printing = false;
    if (scheme.matches) { recolor(); }
  });
}());
