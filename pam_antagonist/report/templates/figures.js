(function () {
  "use strict";
  var plots = Array.prototype.slice.call(document.querySelectorAll(".plot"));
  var drawn = [];
  var busy = false;
  var fingers = window.matchMedia("(pointer: coarse)").matches;

  function timeAxes(layout) {
    return Object.keys(layout).filter(function (key) {
      return /^xaxis[0-9]*$/.test(key) && layout[key].meta === "time";
    });
  }

  // A zoom in one figure's time is a zoom in that of every figure of the same recording.
  function follow(source, event) {
    if (busy) { return; }
    var key = Object.keys(event).filter(function (k) { return /^xaxis[0-9]*\.(range|autorange)/.test(k); })[0];
    if (!key) { return; }
    var axis = key.split(".")[0];
    var shown = source.layout[axis];
    if (!shown || shown.meta !== "time") { return; }
    var range = shown.autorange ? null : shown.range.slice();
    busy = true;
    var todo = drawn.filter(function (other) {
      return other !== source && other.dataset.link === source.dataset.link;
    }).map(function (other) {
      var change = {};
      timeAxes(other.layout).forEach(function (name) {
        if (range) { change[name + ".range"] = range; } else { change[name + ".autorange"] = true; }
      });
      return Object.keys(change).length ? Plotly.relayout(other, change) : null;
    });
    Promise.all(todo).then(function () { busy = false; }, function () { busy = false; });
  }

  // A narrow figure has its buttons in a row of their own, above the legend.
  function fit(plot) {
    var narrow = plot.clientWidth < 560;
    var row = narrow ? 44 : 0;
    var layout = plot.layout;
    layout.width = plot.clientWidth;
    layout.height = Number(plot.dataset.height) + row;
    layout.margin.l = narrow ? 60 : 66;
    layout.margin.t = Number(plot.dataset.top) + row;
    layout.font.size = narrow ? 11 : 12;
    plot.style.height = layout.height + "px";
  }

  function draw(plot) {
    if (plot.classList.contains("drawn")) { return; }
    plot.classList.add("drawn");
    var figure = JSON.parse(document.getElementById(plot.id + "-data").textContent);
    plot.layout = figure.layout;
    plot.dataset.height = figure.layout.height;
    plot.dataset.top = figure.layout.margin.t;
    fit(plot);
    // One finger scrolls the page; the buttons zoom.
    figure.layout.dragmode = fingers ? false : "zoom";
    Plotly.newPlot(plot, figure.data, figure.layout, {
      displaylogo: false, displayModeBar: fingers ? true : "hover",
      modeBarButtons: [["zoomIn2d", "zoomOut2d", "resetScale2d"].concat(fingers ? [] : ["zoom2d", "pan2d", "toImage"])]
    }).then(function () {
      var leader = drawn.filter(function (other) { return other.dataset.link === plot.dataset.link; })[0];
      drawn.push(plot);
      plot.on("plotly_relayout", function (event) { follow(plot, event); });
      if (leader) {
        var axis = timeAxes(leader.layout)[0];
        if (axis && leader.layout[axis].autorange === false) {
          follow(leader, Object.fromEntries([[axis + ".range", true]]));
        }
      }
    });
  }

  // The container, not the window, decides about the width: a fold, a print preview or a turned phone changes it too.
  if ("ResizeObserver" in window) {
    var fitter = new ResizeObserver(function (entries) {
      entries.forEach(function (entry) {
        var plot = entry.target;
        if (plot._fullLayout && Math.abs(plot._fullLayout.width - plot.clientWidth) > 1 && plot.clientWidth > 0) {
          fit(plot);
          Plotly.relayout(plot, {
            width: plot.layout.width, height: plot.layout.height, margin: plot.layout.margin,
            "font.size": plot.layout.font.size
          });
        }
      });
    });
    plots.forEach(function (plot) { fitter.observe(plot); });
  }

  if ("IntersectionObserver" in window) {
    var watcher = new IntersectionObserver(function (entries) {
      entries.forEach(function (entry) {
        if (entry.isIntersecting) { watcher.unobserve(entry.target); draw(entry.target); }
      });
    }, { rootMargin: "600px" });
    plots.forEach(function (plot) { watcher.observe(plot); });
  } else {
    plots.forEach(draw);
  }
  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details").forEach(function (item) { item.open = true; });
    plots.forEach(draw);
  });
}());
