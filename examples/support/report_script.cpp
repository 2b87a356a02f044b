#include "support/report_assets.hpp"

namespace chainslam::support {

const char* const report_script = R"js(
(() => {
'use strict';

const element = id => document.getElementById(id);
const meta = JSON.parse(element('meta').textContent);

function decode(id, Type) {
  const text = atob(element(id).textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; ++i) bytes[i] = text.charCodeAt(i);
  return new Type(bytes.buffer);
}

// ---- plots: values under the pointer ----

function nearest(values, x) {
  let low = 0, high = values.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] <= x) low = middle; else high = middle;
  }
  return Math.abs(values[low] - x) <= Math.abs(values[high] - x) ? low : high;
}

function showTip(tip, panel, event, text) {
  tip.textContent = text;
  tip.style.visibility = 'visible';
  const box = panel.getBoundingClientRect();
  const x = event.clientX - box.left, y = event.clientY - box.top;
  tip.style.left = Math.max(4, x + 14 + tip.offsetWidth < box.width ? x + 14 : x - 14 - tip.offsetWidth) + 'px';
  tip.style.top = Math.max(4, Math.min(y - 10, box.height - tip.offsetHeight - 4)) + 'px';
}

for (const drawing of document.querySelectorAll('.plot')) {
  const plot = meta.plots[Number(drawing.dataset.plot)];
  const panel = drawing.closest('.plot-panel'), tip = panel.querySelector('.tip');
  const area = drawing.querySelector('.area'), frame = area.querySelector('rect');
  const cursor = document.createElementNS(area.namespaceURI, 'line');
  cursor.setAttribute('class', 'cursor');
  cursor.setAttribute('y2', frame.height.baseVal.value);
  cursor.style.visibility = 'hidden';
  area.append(cursor);
  drawing.addEventListener('pointermove', event => {
    const box = frame.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    const x = plot.min_x + share * (plot.max_x - plot.min_x);
    const lines = [plot.x_label + ': ' + x.toPrecision(5)];
    for (const series of plot.series) {
      if (!series.x.length || x < series.x[0] - 0.02 * (plot.max_x - plot.min_x) ||
          x > series.x[series.x.length - 1] + 0.02 * (plot.max_x - plot.min_x)) continue;
      lines.push(series.name + ': ' + Number(series.y[nearest(series.x, x)].toPrecision(4)));
    }
    const drawn = share * frame.width.baseVal.value;
    cursor.setAttribute('x1', drawn);
    cursor.setAttribute('x2', drawn);
    cursor.style.visibility = 'visible';
    showTip(tip, panel, event, lines.slice(0, 14).join('\n'));
  });
  drawing.addEventListener('pointerleave', () => {
    cursor.style.visibility = 'hidden';
    tip.style.visibility = 'hidden';
  });
}

// ---- layers of the plan ----

for (const box of document.querySelectorAll('input[data-switch]')) {
  const shapes = box.closest('.above').querySelectorAll('[data-shape="' + box.dataset.switch + '"]');
  const apply = () => {
    shapes.forEach(shape => shape.classList.toggle('off', !box.checked));
    box.parentElement.classList.toggle('unshown', !box.checked);  // in print
  };
  box.addEventListener('change', apply);
  apply();
}

// ---- 3-D view ----

const canvas = element('view');
if (!canvas) return;
const viewer = canvas.closest('.viewer');

let renderer;
try {
  renderer = new THREE.WebGLRenderer({canvas, antialias: false, powerPreference: 'high-performance'});
} catch (error) {
  viewer.classList.add('failed');
  return;
}
const hasDepth = renderer.extensions.get('WEBGL_depth_texture');
const background = new THREE.Color(0x0d1420);
renderer.setClearColor(background, 1);

let asked = false;  // for a drawing
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(50, 1, 1, 1000);
camera.up.set(0, 0, 1);

function scaled(quantized, low, step) {
  const result = new Float32Array(quantized.length);
  for (let i = 0; i < quantized.length; ++i) result[i] = low[i % 3] + step[i % 3] * quantized[i];
  return result;
}

// Points: discs as large as their spacing, coloured by height, session or not at all.
const pointMaterial = new THREE.ShaderMaterial({
  uniforms: {
    mode: {value: 0}, size: {value: 1}, low: {value: meta.height[0]}, high: {value: meta.height[1]},
    smallest: {value: 1.5},
  },
  vertexShader: `
    attribute vec3 hue;
    uniform float mode, size, low, high, smallest;
    varying vec3 shade;
    vec3 ramp(float t) {
      vec3 a = vec3(0.16, 0.27, 0.52), b = vec3(0.13, 0.51, 0.60), c = vec3(0.38, 0.72, 0.53);
      vec3 d = vec3(0.94, 0.80, 0.41), e = vec3(0.91, 0.45, 0.32);
      t = clamp(t, 0.0, 1.0) * 4.0;
      return t < 1.0 ? mix(a, b, t) : t < 2.0 ? mix(b, c, t - 1.0) : t < 3.0 ? mix(c, d, t - 2.0) : mix(d, e, t - 3.0);
    }
    void main() {
      vec4 seen = modelViewMatrix * vec4(position, 1.0);
      float height = (position.z - low) / max(high - low, 0.01);
      vec3 plain = mix(vec3(0.34, 0.42, 0.53), vec3(0.84, 0.89, 0.95), clamp(height, 0.0, 1.0));
      shade = mode < 0.5 ? ramp(height) : mode < 1.5 ? 0.62 * mix(hue, plain, 0.35) : plain;
      gl_Position = projectionMatrix * seen;
      gl_PointSize = clamp(size / -seen.z, smallest, 24.0);
    }`,
  fragmentShader: `
    varying vec3 shade;
    void main() {
      vec2 from_centre = gl_PointCoord - 0.5;
      if (dot(from_centre, from_centre) > 0.25) discard;
      gl_FragColor = vec4(shade, 1.0);
    }`,
});

const layers = {};
function addTo(layer, object) {
  if (!layers[layer]) {
    layers[layer] = new THREE.Group();
    scene.add(layers[layer]);
  }
  object.frustumCulled = false;
  layers[layer].add(object);
}

const hidden = new Set();  // sessions
const outline = [];  // points that the first view has to show
if (meta.point_count > 0) {
  const positions = scaled(decode('points', Uint16Array), meta.point_low, meta.point_step);
  const sessions = decode('point-sessions', Uint8Array);
  const inside = (value, axis) => axis === 2 || (value >= meta.low[axis] && value <= meta.high[axis]);
  for (let i = 0; i < positions.length; i += 3 * Math.ceil(meta.point_count / 2000)) {
    const point = [positions[i], positions[i + 1], Math.min(meta.height[1], Math.max(meta.height[0], positions[i + 2]))];
    if (point.every(inside)) outline.push(new THREE.Vector3(...point));
  }
  const bySession = new Map();
  for (let i = 0; 3 * i < positions.length; ++i) {
    const session = sessions.length ? sessions[i] : 0;
    if (!bySession.has(session)) bySession.set(session, []);
    bySession.get(session).push(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]);
  }
  for (const [session, list] of bySession) {
    const geometry = new THREE.BufferGeometry();
    const color = meta.session_colors[session % meta.session_colors.length];
    const hues = new Uint8Array(list.length);
    for (let i = 0; i < list.length; ++i) hues[i] = color >> (16 - 8 * (i % 3)) & 255;
    geometry.setAttribute('position', new THREE.BufferAttribute(new Float32Array(list), 3));
    geometry.setAttribute('hue', new THREE.BufferAttribute(hues, 3, true));
    const points = new THREE.Points(geometry, pointMaterial);
    points.userData.session = session;
    addTo('points', points);
  }
}

// Lines as wide as they should be on any machine: each is a strip of two triangles that the shader widens on the screen.
const lineUniforms = {resolution: {value: new THREE.Vector2(1, 1)}};
function lines(pairs, color, width, nearness) {  // of lines in one place, the nearer one is seen
  const count = pairs.length / 6;
  const starts = new Float32Array(12 * count), ends = new Float32Array(12 * count), corners = new Float32Array(8 * count);
  const triangles = new Uint32Array(6 * count);
  for (let i = 0; i < count; ++i) {
    for (let corner = 0; corner < 4; ++corner) {
      starts.set(pairs.subarray(6 * i, 6 * i + 3), 12 * i + 3 * corner);
      ends.set(pairs.subarray(6 * i + 3, 6 * i + 6), 12 * i + 3 * corner);
      corners.set([corner >> 1, corner & 1 ? 1 : -1], 8 * i + 2 * corner);
    }
    triangles.set([0, 1, 2, 2, 1, 3].map(corner => 4 * i + corner), 6 * i);
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute('position', new THREE.BufferAttribute(starts, 3));
  geometry.setAttribute('end', new THREE.BufferAttribute(ends, 3));
  geometry.setAttribute('corner', new THREE.BufferAttribute(corners, 2));
  geometry.setIndex(new THREE.BufferAttribute(triangles, 1));
  return new THREE.Mesh(geometry, new THREE.ShaderMaterial({
    side: THREE.DoubleSide,
    uniforms: {
      color: {value: new THREE.Color(color)}, width: {value: width}, nearness: {value: nearness},
      resolution: lineUniforms.resolution,
    },
    vertexShader: `
      attribute vec3 end;
      attribute vec2 corner;
      uniform vec2 resolution;
      uniform float width, nearness;
      void main() {
        vec4 a = modelViewMatrix * vec4(position, 1.0), b = modelViewMatrix * vec4(end, 1.0);
        float near = projectionMatrix[3][2] / (projectionMatrix[2][2] - 1.0);
        if (a.z > -near && b.z < -near) a = mix(a, b, (a.z + near) / (a.z - b.z) + 1e-4);
        if (b.z > -near && a.z < -near) b = mix(b, a, (b.z + near) / (b.z - a.z) + 1e-4);
        vec4 p = projectionMatrix * a, q = projectionMatrix * b;
        vec2 along = (q.xy / q.w - p.xy / p.w) * resolution;
        along = length(along) > 1e-6 ? normalize(along) : vec2(1.0, 0.0);
        vec4 here = corner.x < 0.5 ? p : q;
        vec2 away = vec2(-along.y, along.x) * corner.y + along * (corner.x * 2.0 - 1.0);
        here.xy += away * width / resolution * here.w;
        here.z -= 1e-4 * nearness * here.w;
        gl_Position = here;
      }`,
    fragmentShader: `
      uniform vec3 color;
      void main() { gl_FragColor = vec4(color, 1.0); }`,
  }));
}

const pathPositions = decode('paths', Float32Array);
const keyframes = [];
for (const path of meta.paths) {
  const positions = pathPositions.subarray(3 * path.first, 3 * (path.first + path.count));
  const step = path.kind === 'odometry' ? 2 : 1;  // every other piece: dashes
  const pairs = [];
  for (let i = 0; i + 1 < path.count; i += step)
    for (let j = 0; j < 6; ++j) pairs.push(positions[3 * i + j]);
  const width = {optimized: 3, odometry: 1.4, truth: 1.2}[path.kind];
  const color = path.kind === 'truth' ? 0xffffff : meta.session_colors[path.session % meta.session_colors.length];
  const mesh = lines(new Float32Array(pairs), color, width, {optimized: 6, odometry: 2, truth: 1}[path.kind]);
  mesh.userData.session = path.session;
  addTo(path.kind, mesh);
  if (path.kind === 'optimized')
    for (let i = 0; i < path.count; ++i)
      keyframes.push({
        position: new THREE.Vector3().fromArray(positions, 3 * i), session: path.session, number: keyframes.length,
        time: path.times.length ? path.times[i] : null,
      });
}

const closures = decode('closures', Int32Array);
for (const [kind, name] of meta.closure_kinds.entries()) {
  const dashes = name === 'chained' ? 4 : 1, width = {direct: 1.8, chained: 1.5, merge: 5}[name];
  const pairs = [];
  for (let i = 0; i < closures.length; i += 3) {
    if (closures[i + 2] !== kind) continue;
    const from = keyframes[closures[i]].position, to = keyframes[closures[i + 1]].position;
    for (let dash = 0; dash < dashes; ++dash)
      for (const share of [2 * dash, 2 * dash + 1])
        pairs.push(...from.clone().lerp(to, share / (2 * dashes - 1)).toArray());
  }
  if (pairs.length) addTo(name, lines(new Float32Array(pairs), meta.closure_colors[kind], width, name === 'merge' ? 8 : 4));
}

// Eye-dome lighting (Boucheny 2009): what is farther than its neighbours on the screen is darker.
const target = new THREE.WebGLRenderTarget(1, 1, {minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter});
if (hasDepth) {
  target.depthTexture = new THREE.DepthTexture();
  target.depthTexture.type = THREE.UnsignedIntType;
}
const shading = new THREE.ShaderMaterial({
  depthTest: false,
  depthWrite: false,
  uniforms: {
    image: {value: target.texture}, depth: {value: target.depthTexture || null}, pixel: {value: new THREE.Vector2()},
    near: {value: 1}, far: {value: 2}, lit: {value: hasDepth ? 1 : 0},
  },
  vertexShader: 'varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }',
  fragmentShader: `
    varying vec2 at;
    uniform sampler2D image, depth;
    uniform vec2 pixel;
    uniform float near, far, lit;
    float distance_at(vec2 place) {
      float d = texture2D(depth, place).x;
      return d >= 1.0 ? log2(far) : log2(near * far / (far - d * (far - near)));
    }
    void main() {
      vec4 color = texture2D(image, at);
      float dark = 0.0;
      if (lit > 0.5) {
        float here = distance_at(at);
        for (int i = 0; i < 8; ++i) {
          float angle = 0.785398 * float(i);
          dark += max(0.0, here - distance_at(at + 1.6 * pixel * vec2(cos(angle), sin(angle))));
        }
      }
      gl_FragColor = vec4(color.rgb * exp(-min(dark, 0.12) * 9.0), 1.0);
    }`,
});
const screen = new THREE.Scene();
const quad = new THREE.Mesh(new THREE.PlaneBufferGeometry(2, 2), shading);
quad.frustumCulled = false;
screen.add(quad);
const flat = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);

// ---- camera: orbit, pan, zoom ----

const home = {centre: new THREE.Vector3().fromArray(meta.centre), reach: meta.reach};
const orbit = {}, seen = new THREE.Vector3();
let framed = null;  // direction of a view that the map fills, until the user moves it: kept when the window changes
function look(azimuth, elevation) {
  framed = [azimuth, elevation];
  orbit.target = home.centre.clone();
  orbit.azimuth = azimuth;
  orbit.elevation = elevation;
  orbit.distance = 2 * home.reach;
  for (let round = 0; round < 24; ++round) fit();
  requestDraw();
}

if (!outline.length)
  for (let corner = 0; corner < 8; ++corner)
    outline.push(new THREE.Vector3(
      corner & 1 ? meta.high[0] : meta.low[0], corner & 2 ? meta.high[1] : meta.low[1], meta.height[corner >> 2]));

// One step towards a view that the map just fills.
function fit() {
  place();
  camera.updateMatrixWorld();
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (const point of outline) {
    seen.copy(point).project(camera);
    [seen.x, seen.y].forEach((value, axis) => {
      low[axis] = Math.min(low[axis], value);
      high[axis] = Math.max(high[axis], value);
    });
  }
  pan(-(low[0] + high[0]) / 4 * canvas.clientWidth, (low[1] + high[1]) / 4 * canvas.clientHeight);
  orbit.distance *= Math.max(0.4, Math.max(high[0] - low[0], high[1] - low[1]) / 2 / 0.94);
}

function place() {
  const flatness = Math.cos(orbit.elevation);
  camera.position.set(
    orbit.target.x + orbit.distance * flatness * Math.cos(orbit.azimuth),
    orbit.target.y + orbit.distance * flatness * Math.sin(orbit.azimuth),
    orbit.target.z + orbit.distance * Math.sin(orbit.elevation));
  camera.lookAt(orbit.target);
  camera.near = Math.max(0.05, orbit.distance / 500);
  camera.far = orbit.distance + 6 * home.reach;
  camera.updateProjectionMatrix();
}

function turn(dx, dy) {
  orbit.azimuth -= 0.006 * dx;
  orbit.elevation = Math.min(Math.PI / 2 - 1e-3, Math.max(-0.3, orbit.elevation + 0.006 * dy));
  requestDraw();
}
function pan(dx, dy) {
  const metres = 2 * orbit.distance * Math.tan(camera.fov * Math.PI / 360) / canvas.clientHeight;
  const ahead = -dy * metres / Math.max(0.3, Math.sin(Math.abs(orbit.elevation)));
  orbit.target.x += metres * dx * Math.sin(orbit.azimuth) + ahead * Math.cos(orbit.azimuth);
  orbit.target.y += -metres * dx * Math.cos(orbit.azimuth) + ahead * Math.sin(orbit.azimuth);
  requestDraw();
}
function zoom(factor) {
  orbit.distance = Math.min(20 * home.reach, Math.max(2, orbit.distance * factor));
  requestDraw();
}

for (const name of ['pointerdown', 'wheel', 'keydown', 'dblclick'])
  canvas.addEventListener(name, () => { framed = null; }, {passive: true});

const held = new Map();
canvas.addEventListener('pointerdown', event => {
  canvas.setPointerCapture(event.pointerId);
  held.set(event.pointerId, [event.clientX, event.clientY]);
});
canvas.addEventListener('pointermove', event => {
  const last = held.get(event.pointerId);
  if (!last) return tell(event);
  tip.style.visibility = 'hidden';
  const dx = event.clientX - last[0], dy = event.clientY - last[1];
  if (held.size === 2) {
    const other = [...held].find(([id]) => id !== event.pointerId)[1];
    const before = Math.hypot(last[0] - other[0], last[1] - other[1]);
    const after = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
    zoom(before / Math.max(1, after));
    pan(dx / 2, dy / 2);
  } else if (event.buttons & 2 || event.shiftKey || event.ctrlKey) {
    pan(dx, dy);
  } else {
    turn(dx, dy);
  }
  held.set(event.pointerId, [event.clientX, event.clientY]);
});
for (const name of ['pointerup', 'pointercancel'])
  canvas.addEventListener(name, event => held.delete(event.pointerId));
canvas.addEventListener('pointerleave', () => { tip.style.visibility = 'hidden'; });
canvas.addEventListener('contextmenu', event => event.preventDefault());
canvas.addEventListener('wheel', event => {
  event.preventDefault();
  zoom(Math.exp(Math.max(-0.5, Math.min(0.5, event.deltaY * 0.0015))));
}, {passive: false});
canvas.addEventListener('keydown', event => {
  const actions = {
    ArrowLeft: () => turn(-20, 0), ArrowRight: () => turn(20, 0), ArrowUp: () => turn(0, 20), ArrowDown: () => turn(0, -20),
    '+': () => zoom(0.85), '=': () => zoom(0.85), '-': () => zoom(1.18),
  };
  if (!actions[event.key]) return;
  event.preventDefault();
  actions[event.key]();
});

// ---- keyframe under the pointer ----

const tip = viewer.querySelector('.tip');
function keyframeAt(event) {
  if (layers.optimized && !layers.optimized.visible) return null;
  const box = canvas.getBoundingClientRect();
  let best = null, bestDistance = 12;
  for (const keyframe of keyframes) {
    if (hidden.has(keyframe.session)) continue;
    seen.copy(keyframe.position).project(camera);
    if (seen.z > 1) continue;
    const x = box.left + (seen.x + 1) / 2 * box.width, y = box.top + (1 - seen.y) / 2 * box.height;
    const distance = Math.hypot(x - event.clientX, y - event.clientY);
    if (distance < bestDistance) [best, bestDistance] = [keyframe, distance];
  }
  return best;
}
function tell(event) {
  const keyframe = keyframeAt(event);
  if (!keyframe) {
    tip.style.visibility = 'hidden';
    return;
  }
  const time = keyframe.time === null ? '' : '\n' + keyframe.time.toFixed(1) + ' s';
  const p = keyframe.position.toArray().map((value, i) => (value + meta.origin[i] - meta.session_offsets[keyframe.session][i]).toFixed(1));
  showTip(tip, viewer, event, meta.session_names[keyframe.session] + '\nkeyframe ' + keyframe.number + time + '\n' + p.join(', ') + ' m');
}
canvas.addEventListener('dblclick', event => {
  const keyframe = keyframeAt(event);
  if (!keyframe) return;
  orbit.target.copy(keyframe.position);
  zoom(0.4);
});

// ---- controls ----

for (const box of document.querySelectorAll('input[data-layer]')) {
  const apply = () => {
    if (layers[box.dataset.layer]) layers[box.dataset.layer].visible = box.checked;
    requestDraw();
  };
  box.addEventListener('change', apply);
  apply();
}
for (const box of document.querySelectorAll('input[data-session]')) {
  const session = Number(box.dataset.session);
  const apply = () => {
    if (box.checked) hidden.delete(session); else hidden.add(session);
    for (const name in layers)
      for (const object of layers[name].children)
        if (object.userData.session === session) object.visible = box.checked;
    requestDraw();
  };
  box.addEventListener('change', apply);
  apply();
}
const colorMode = element('color-mode');
const applyColorMode = () => {
  pointMaterial.uniforms.mode.value = Number(colorMode.value);
  requestDraw();
};
colorMode.addEventListener('change', applyColorMode);
applyColorMode();
element('point-size').addEventListener('input', requestDraw);
const views = {
  'view-above': () => look(-Math.PI / 2, Math.PI / 2 - 1e-3),
  'view-reset': () => look(-Math.PI / 2 - 0.5, 0.75),
  'view-side': () => look(-Math.PI / 2, 0.12),
};
for (const id in views) element(id).addEventListener('click', views[id]);

// ---- drawing: when something has changed, not otherwise ----

function requestDraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(draw);
}

function draw() {
  asked = false;
  place();
  const density = target.width / canvas.clientWidth;
  const tall = target.height / (2 * Math.tan(camera.fov * Math.PI / 360));
  pointMaterial.uniforms.size.value = meta.point_size * tall * 1.15 * Math.exp(Number(element('point-size').value));
  pointMaterial.uniforms.smallest.value = 1.2 * density;
  lineUniforms.resolution.value.set(canvas.clientWidth, canvas.clientHeight);
  shading.uniforms.near.value = camera.near;
  shading.uniforms.far.value = camera.far;
  shading.uniforms.pixel.value.set(1 / target.width, 1 / target.height);
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  renderer.setRenderTarget(null);
  renderer.render(screen, flat);
  if (!performance.getEntriesByName('first frame').length) performance.mark('first frame');
}

const shown = {width: 0, height: 0};
function resize() {
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (!width || !height || (width === shown.width && height === shown.height)) return;  // an observer calls at first, too
  Object.assign(shown, {width, height});
  const density = Math.min(window.devicePixelRatio || 1, 2);
  renderer.setPixelRatio(density);
  renderer.setSize(width, height, false);
  const sharp = Math.max(density, 1.5);  // drawn finer than shown, for smooth edges
  target.setSize(Math.round(width * sharp), Math.round(height * sharp));
  camera.aspect = width / height;
  if (framed) look(...framed);
  requestDraw();
}

canvas.addEventListener('webglcontextlost', () => viewer.classList.add('failed'));
canvas.addEventListener('webglcontextrestored', () => viewer.classList.remove('failed'));
new ResizeObserver(resize).observe(canvas);
resize();
look(-Math.PI / 2 - 0.5, 0.75);
})();
)js";

}  // namespace chainslam::support
