#include "support/report_assets.hpp"

namespace chainslam::support {

const char* const report_style = R"css(
:root {
  color-scheme: light dark;
  --page: #f6f7f9; --panel: #ffffff; --ink: #17212f; --quiet: #5b6b80; --rule: #e1e6ed; --accent: #2563eb;
  --points: #334155; --grid: #e6eaf0; --warning: #92400e; --warning-panel: #fef3c7;
}
@media (prefers-color-scheme: dark) {
  :root {
    --page: #0b1119; --panel: #121b27; --ink: #e6edf5; --quiet: #93a4b8; --rule: #223042; --accent: #60a5fa;
    --points: #a9bbd0; --grid: #1e2b3b; --warning: #fcd34d; --warning-panel: #2b2410;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif;
}
main { max-width: 1180px; margin: 0 auto; padding: 40px 24px 64px; }
header h1 { margin: 0; font-size: 32px; line-height: 1.2; font-weight: 650; letter-spacing: -0.01em; overflow-wrap: anywhere; }
header p { margin: 6px 0 0; color: var(--quiet); font-size: 16px; max-width: 75ch; overflow-wrap: anywhere; }
.kicker { margin: 0 0 6px; color: var(--accent); font-size: 13px; font-weight: 600; letter-spacing: 0.08em; text-transform: uppercase; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(168px, 1fr)); gap: 12px; margin: 28px 0 0; }
.figure { background: var(--panel); border: 1px solid var(--rule); border-radius: 10px; padding: 14px 16px; }
.figure dt { color: var(--quiet); font-size: 13px; }
.figure dd { margin: 2px 0 0; font-size: 25px; font-weight: 620; font-variant-numeric: tabular-nums; letter-spacing: -0.01em; }
.figure dd.note { font-size: 13px; font-weight: 400; color: var(--quiet); letter-spacing: 0; }
header .verdict { color: var(--ink); font-weight: 600; }
header .verdict.failed { padding: 12px 18px; background: var(--warning-panel); color: var(--warning); border-radius: 10px; font-size: 17px; }
.answers { margin: 18px 0 0; max-width: 100ch; }
.answers div { display: grid; grid-template-columns: 140px minmax(0, 1fr); gap: 0 16px; padding: 5px 0; border-top: 1px solid var(--rule); }
.answers dt { color: var(--quiet); }
.answers dd { margin: 0; overflow-wrap: anywhere; }
a { color: var(--accent); }
.warnings { margin: 20px 0 0; padding: 12px 18px 12px 34px; background: var(--warning-panel); color: var(--warning); border-radius: 10px; }
section { margin-top: 44px; }
h2 { margin: 0 0 4px; font-size: 20px; font-weight: 620; }
h3 { margin: 26px 0 6px; font-size: 15px; font-weight: 620; }
section > p { margin: 0 0 12px; color: var(--quiet); max-width: 80ch; }
.panel { background: var(--panel); border: 1px solid var(--rule); border-radius: 10px; overflow: hidden; }

.viewer { background: #0d1420; position: relative; }
.viewer canvas { display: block; width: 100%; height: 620px; outline: none; cursor: grab; touch-action: none; }
.viewer canvas:active { cursor: grabbing; }
.viewer canvas:focus-visible { box-shadow: inset 0 0 0 2px #60a5fa; }
.controls {
  display: flex; flex-wrap: wrap; gap: 8px 18px; align-items: center; padding: 10px 14px;
  border-top: 1px solid var(--rule); font-size: 13px;
}
.controls label { display: inline-flex; align-items: center; gap: 6px; white-space: nowrap; }
.controls .space { flex: 1; }
button, select {
  font: inherit; color: inherit; background: var(--page); border: 1px solid var(--rule); border-radius: 6px; padding: 3px 10px;
}
button:hover, select:hover { border-color: var(--accent); }
input { accent-color: var(--accent); margin: 0; }
input[type=range] { width: 90px; }
.controls p { flex-basis: 100%; margin: 0; color: var(--quiet); font-size: 12.5px; }
.tip {
  position: absolute; pointer-events: none; visibility: hidden; background: #1c2838; color: #e6edf5; border: 1px solid #33465e;
  border-radius: 6px; padding: 4px 9px; font-size: 12px; line-height: 1.45; white-space: pre; z-index: 3;
  font-variant-numeric: tabular-nums;
}
.no-webgl { display: none; margin: 0; padding: 60px 24px; color: #c6d2e0; text-align: center; }
.viewer.failed canvas, .viewer.failed + .controls { display: none; }
.viewer.failed .no-webgl { display: block; }

.above { padding: 0; }
.above svg { display: block; width: 100%; height: auto; max-height: 900px; }
.above image { opacity: 0.95; }
@media (prefers-color-scheme: dark) { .above image { filter: invert(1); opacity: 0.8; } }
.above .path { fill: none; stroke: var(--c); stroke-width: 2; stroke-linejoin: round; vector-effect: non-scaling-stroke; }
.above .off { display: none; }
.above .odometry { stroke-dasharray: 5 4; stroke-width: 1.2; opacity: 0.75; }
.above .truth { stroke: var(--ink); stroke-width: 1; opacity: 0.8; }
.above .path.lost { stroke: #d00000; stroke-width: 5; }
.above circle.lost { fill: none; stroke: #d00000; stroke-width: 2; vector-effect: non-scaling-stroke; }
.swatch.lost { border-top: 5px solid #d00000; }
.above .component { fill: none; stroke: var(--c); stroke-width: 13; stroke-linecap: round; stroke-linejoin: round; vector-effect: non-scaling-stroke; opacity: 0.75; }
.above .number { font-weight: 650; paint-order: stroke; stroke: var(--panel); stroke-width: 4px; }
.above .closures { fill: none; stroke: var(--c); stroke-width: 1.3; vector-effect: non-scaling-stroke; opacity: 0.85; }
.above .chained { stroke-dasharray: 3 2.5; }
.above .merge { stroke-width: 3; stroke-linecap: round; opacity: 1; }
.above .casing { fill: none; stroke: #111827; stroke-width: 5.5; stroke-linecap: round; vector-effect: non-scaling-stroke; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr)); gap: 16px; margin-top: 12px; }
.pair figure { margin: 0; display: flex; flex-direction: column; }
.pair .path { stroke-width: 1.6; }
.pair svg { flex: 1; }
figcaption { padding: 8px 14px; border-top: 1px solid var(--rule); font-size: 13px; color: var(--quiet); }
.above .bar { stroke: var(--ink); stroke-width: 1.5; vector-effect: non-scaling-stroke; fill: none; }
.above text { fill: var(--ink); font-size: 15px; }
.legend { display: flex; flex-wrap: wrap; gap: 4px 20px; padding: 10px 14px; border-top: 1px solid var(--rule); font-size: 13px; }
.legend span, .legend label { display: inline-flex; align-items: center; gap: 7px; overflow-wrap: anywhere; }
.swatch { display: inline-block; width: 16px; height: 0; border-top: 3px solid var(--c, currentColor); border-radius: 2px; flex: none; }
.swatch.odometry { width: 22px; border-top: 2px dashed var(--c, currentColor); border-radius: 0; }
.swatch.chained { width: 18px; border-top-style: dashed; border-radius: 0; }
.swatch.merge { height: 5px; border: 1px solid #111827; background: var(--c); }
.swatch.component { height: 10px; border: 0; background: var(--c); border-radius: 5px; }
.controls .sessions { display: flex; flex-wrap: wrap; gap: 6px 18px; flex-basis: 100%; }
.swatch.truth { border-top-color: var(--ink); border-top-width: 1.5px; }
.viewer + .controls .swatch.truth { border-top-color: currentColor; }

.plot { position: relative; height: 278px; touch-action: pan-y; }
.plot .area { position: absolute; left: 58px; top: 12px; width: calc(100% - 72px); height: 220px; overflow: visible; }
.plot rect { fill: none; }
.plot .grid line { stroke: var(--grid); stroke-width: 1; vector-effect: non-scaling-stroke; }
.plot .lines polyline { fill: none; stroke: var(--c); stroke-width: 1.6; stroke-linejoin: round; vector-effect: non-scaling-stroke; }
.plot .lines .dashed { stroke-dasharray: 6 4; }
.plot text { fill: var(--quiet); font-size: 12px; font-variant-numeric: tabular-nums; }
.plot text.axis { fill: var(--ink); }
.plot .cursor { stroke: var(--quiet); stroke-width: 1; stroke-dasharray: 3 3; vector-effect: non-scaling-stroke; }
.plot-panel { position: relative; padding: 10px 10px 4px; }
.plot-panel .legend { border: 0; padding: 4px 6px 8px 48px; }

.columns { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr)); gap: 0 28px; align-items: start; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: 7px 12px; text-align: left; border-top: 1px solid var(--rule); overflow-wrap: anywhere; }
tr:first-child th, tr:first-child td { border-top: 0; }
thead th { font-size: 13px; font-weight: 500; color: var(--quiet); vertical-align: bottom; overflow-wrap: normal; }
thead + tbody tr:first-child th, thead + tbody tr:first-child td { border-top: 1px solid var(--rule); }
tbody th { min-width: 96px; font-weight: 450; }
.n { text-align: right; }
td.n { white-space: nowrap; }
td.words { min-width: 190px; }
footer { margin-top: 48px; color: var(--quiet); font-size: 13px; }

@media (max-width: 600px) {
  main { padding: 20px 14px 40px; }
  header h1 { font-size: 24px; }
  .answers div { display: block; }
  .answers dt { font-size: 13px; }
  .figures { grid-template-columns: repeat(auto-fit, minmax(140px, 1fr)); gap: 8px; }
  .figure { padding: 10px 12px; }
  .figure dd { font-size: 20px; }
  .viewer canvas { height: 400px; }
  .above text { font-size: 36px; }
  .above .number { stroke-width: 9px; }
  .pair text { font-size: 22px; }
  .plot .wide { display: none; }
  .plot-panel .legend { padding-left: 6px; }
  th, td { padding: 6px 8px; }
}

@media print {
  :root {
    color-scheme: light;
    --page: #ffffff; --panel: #ffffff; --ink: #000000; --quiet: #444444; --rule: #cccccc; --accent: #1d4ed8;
    --points: #334155; --grid: #e0e0e0; --warning: #7c2d12; --warning-panel: #ffffff;
  }
  body { font-size: 13px; }
  .above image { filter: none; opacity: 0.95; }
  .above svg { max-height: 560px; }
  .above text { font-size: 22px; }
  .pair text { font-size: 22px; }
  .pair { grid-template-columns: 1fr 1fr; }
  main { max-width: none; padding: 0; }
  .interactive, .legend input, .legend .unshown { display: none; }
  .warnings, header .verdict.failed { border: 1px solid var(--warning); }
  .panel, .figure, tr { break-inside: avoid; }
  h2, h3, section > p { break-after: avoid; }
  section { margin-top: 28px; }
  .scroll { overflow: visible; }
  table, thead th { font-size: 11px; }
  th, td { padding: 4px 6px; }
  tbody th { min-width: 70px; }
  td.words { min-width: 110px; }
}
)css";

}  // namespace chainslam::support
