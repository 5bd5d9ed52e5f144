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

  // A narrow figure has its buttons in a row of their own, above the legend.
  function fit(plot) {
    const narrow = plot.clientWidth < 560;
    const row = narrow ? 44 : 0;
    const layout = plot.layout;
    layout.width = plot.clientWidth;
    layout.height = Number(plot.dataset.height) + row;
    layout.margin.l = narrow ? 60 : 66;
    layout.margin.t = Number(plot.dataset.top) + row;
    layout.font.size = narrow ? 11 : 12;
    plot.style.height = layout.height + "px";
  }

  function show(plot) {
    const figure = JSON.parse(colored(plot.source));
    const before = plot.layout;
    plot.dataset.height = figure.layout.height;
    plot.dataset.top = figure.layout.margin.t;
    plot.layout = figure.layout;
    fit(plot);
    // What was zoomed stays so when the colours change.
    axesOf(before || {}, /^[xy]axis/).filter((key) => before[key].autorange === false).forEach((key) => {
      figure.layout[key].range = before[key].range.slice();
    });
    // One finger scrolls the page; the buttons zoom.
    figure.layout.dragmode = fingers ? false : "zoom";
    return Plotly.newPlot(plot, figure.data, figure.layout, {
      displaylogo: false, displayModeBar: fingers ? true : "hover",
      modeBarButtons: [["zoomIn2d", "zoomOut2d", "resetScale2d"].concat(fingers ? [] : ["zoom2d", "pan2d", "toImage"])]
    }).then(() => { plot.on("plotly_relayout", (event) => follow(plot, event)); });
  }

  function draw(plot) {
    if (plot.classList.contains("drawn")) { return; }
    plot.classList.add("drawn");
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
