"""The style sheet of a report: readable at any width, on paper, and without telling colours apart."""

MEASURED = "#1a1a1a"
"""Black, as in the paper: what a sensor said."""
ESTIMATE = "#d55e00"
"""Vermilion: the filter. The colours are Okabe and Ito's, which every kind of colour vision tells apart."""
MODEL = "#0072b2"
"""Blue: the model alone."""
HELD_OUT = "rgba(11, 92, 138, 0.07)"
"""Shade of what was held out."""
SECOND = "#009e73"
"""Bluish green: a second channel of the same kind."""
QUIET = "#8a8f98"
"""Grey: bounds, references, raw data behind a summary."""
EDGE = "#8a3b00"
"""Dark vermilion: the edge of the filter's 95 % interval, where data would hide the shade."""
BAND = "rgba(213, 94, 0, 0.20)"
"""The filter's 95 % interval."""

CSS = """
:root { --ink:#1a1d21; --soft:#565d66; --line:#dde1e6; --wash:#f6f7f9; --accent:#0b5c8a;
  --good:#1b7a4b; --warn:#b45309; --note:#49637a; }
* { box-sizing:border-box; }
html { color-scheme:light; -webkit-text-size-adjust:100%; scroll-behavior:smooth; }
body { margin:0; background:#fff; color:var(--ink);
  font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",sans-serif; }
main { max-width:1080px; margin:0 auto; padding:28px 24px 64px; }
.kicker { margin:0 0 2px; font-size:13px; letter-spacing:.04em; color:var(--soft); }
h1 { margin:0 0 10px; font-size:30px; line-height:1.2; overflow-wrap:anywhere; }
h2 { margin:44px 0 8px; padding-top:14px; border-top:2px solid var(--ink); font-size:23px; line-height:1.25;
  overflow-wrap:anywhere; }
h3 { margin:30px 0 4px; font-size:18px; }
p { margin:6px 0 12px; max-width:76ch; }
.lede { color:var(--soft); }
.verdict { margin:16px 0 18px; padding:14px 18px; border-left:6px solid var(--accent); background:var(--wash);
  font-size:21px; line-height:1.4; max-width:none; }
.tiles { display:grid; grid-template-columns:repeat(auto-fit,minmax(150px,1fr)); gap:12px; margin:16px 0; }
.tile { border:1px solid var(--line); border-radius:8px; padding:10px 14px; }
.tile .label { font-size:13px; color:var(--soft); }
.tile .value { font-size:27px; font-weight:650; line-height:1.25; font-variant-numeric:tabular-nums; }
.tile .note { font-size:13px; color:var(--soft); line-height:1.35; }
ul.findings { list-style:none; margin:12px 0; padding:0; }
ul.findings li { display:grid; grid-template-columns:26px 1fr; gap:8px; padding:5px 0; max-width:84ch; }
.mark { width:22px; height:22px; margin-top:2px; border-radius:50%; color:#fff; font-weight:700; font-size:14px;
  line-height:22px; text-align:center; }
.mark.good { background:var(--good); } .mark.warn { background:var(--warn); } .mark.note { background:var(--note); }
.columns { display:grid; grid-template-columns:1fr; gap:0 36px; }
@media (min-width:900px) { .columns { grid-template-columns:minmax(0,1fr) auto; } }
.columns > div { min-width:0; } .columns .about { margin-top:12px; }
.scroll { overflow-x:auto; margin:6px 0 12px; }
table { border-collapse:collapse; font-size:15px; font-variant-numeric:tabular-nums; }
td:not(.text) { white-space:nowrap; } td:first-child { white-space:normal; }
th,td { padding:5px 16px 5px 0; text-align:right; border-bottom:1px solid var(--line); vertical-align:top; }
th:first-child,td:first-child { text-align:left; }
thead th { border-bottom:2px solid var(--ink); font-weight:600; }
td.text { text-align:left; overflow-wrap:anywhere; }
td.best { font-weight:700; }
tbody tr.group th { padding-top:14px; border-bottom:1px solid var(--soft); }
nav { display:flex; flex-wrap:wrap; gap:6px 16px; margin:10px 0; font-size:14px; }
a { color:var(--accent); }
figure { margin:14px 0 26px; }
figcaption { margin:0 0 2px; font-weight:600; }
.about { margin:0 0 6px; color:var(--soft); font-size:14px; line-height:1.45; }
.plot { width:100%; min-height:120px; background:var(--wash); }
.plot.drawn { background:none; }
details { margin:14px 0; border:1px solid var(--line); border-radius:8px; padding:8px 14px; }
summary { cursor:pointer; font-weight:600; }
dl { margin:10px 0; } dt { font-weight:600; margin-top:8px; } dd { margin:0 0 4px; max-width:76ch; }
footer { margin-top:48px; padding-top:12px; border-top:1px solid var(--line); font-size:13px; color:var(--soft);
  overflow-wrap:anywhere; }
@media (max-width:600px) {
  main { padding:18px 14px 48px; } h1 { font-size:24px; } h2 { font-size:20px; }
  .verdict { font-size:18px; padding:12px 14px; } .tiles { grid-template-columns:1fr 1fr; }
  .tile .value { font-size:22px; } table { font-size:14px; } th,td { padding-right:12px; }
  /* It lies on the legend; a finger zooms by dragging, and a double tap goes back. */
  .modebar { display:none !important; }
}
@media print {
  main { max-width:none; padding:0; } body { font-size:11pt; } h2 { break-before:auto; }
  figure,.tile,table,.verdict { break-inside:avoid; } details { border:none; padding:0; } nav,.modebar { display:none; }
}
"""
