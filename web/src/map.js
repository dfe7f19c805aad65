// SPDX-License-Identifier: BSD-3-Clause
// The map of a run: points, paths, candidates and radio in 3D, z up.
import {
  BufferAttribute, BufferGeometry, CanvasTexture, Color, ColorManagement, Group, LineBasicMaterial, LinearSRGBColorSpace,
  LineSegments, PerspectiveCamera, Points, PointsMaterial, Scene, Vector3, WebGLRenderer,
} from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { Line2 } from 'three/addons/lines/Line2.js';
import { LineGeometry } from 'three/addons/lines/LineGeometry.js';
import { LineMaterial } from 'three/addons/lines/LineMaterial.js';
import { LineSegments2 } from 'three/addons/lines/LineSegments2.js';
import { LineSegmentsGeometry } from 'three/addons/lines/LineSegmentsGeometry.js';
import { ink, rgb, robotColour, scale } from './palette.js';
import { fixed, h, isNumber, metres } from './dom.js';

// Nothing is lit: colours are shown as they are given, so that the legend shows the same.
ColorManagement.enabled = false;

const kFat = 4000; // segments up to which lines are drawn with a width

/** Nodes [begin, end) of each robot. */
export const ranges = (nodes) => nodes.begin.map((from, i) => [from, nodes.begin[i + 1] ?? nodes.count]);

/** What may be shown of a scene: [{id, label, total, drawn, on, swatch}]. */
export function layersOf(scene) {
  const { nodes, points, candidates, radio, beacons } = scene;
  const colours = ink();
  const paths = (id, label, on, swatch) => ({ id, label, total: nodes.count, drawn: Math.ceil(nodes.count / nodes.stride), on, swatch, unit: 'nodes' });
  const pairs = (id, label, one, on, colour) => one && { id, label, total: one.total, drawn: one.drawn, on, swatch: { line: colour }, unit: 'pairs' };
  return [
    points && { id: 'points', label: 'Map points', total: points.total, drawn: points.drawn, on: true, swatch: { scale: true }, unit: 'points' },
    paths('optimized', 'Optimised paths', true, { line: 'robot', width: 3 }),
    nodes.odometry && paths('odometry', 'Odometry alone', true, { line: 'robot', dashed: true }),
    nodes.truth && paths('truth', 'True paths', false, { line: colours.truth, width: 6, faint: true }),
    nodes.reference && paths('reference', 'Optimised by another program', false, { line: colours.soft, dashed: true }),
    pairs('kept', 'Closures kept', candidates.kept, true, colours.kept),
    pairs('outlier', 'Closures left out by GNC', candidates.outlier, true, colours.outlier),
    pairs('rejected', 'Computed and rejected', candidates.rejected, false, colours.rejected),
    pairs('selected', 'Selected to be computed', candidates.selected, false, colours.selected),
    beacons && beacons.length > 0 && { id: 'beacons', label: 'Radio beacons', total: beacons.length, drawn: beacons.length, on: true, swatch: { mark: '▲' }, unit: 'beacons' },
    radio && { id: 'radio', label: `Fly-bys (${radio.passes})`, total: radio.total, drawn: radio.drawn, on: false, swatch: { line: colours.radio }, unit: 'nodes in reach' },
  ].filter(Boolean);
}

function triangle() {
  const size = 64;
  const canvas = h('canvas', { width: size, height: size });
  const pen = canvas.getContext('2d');
  const shape = (grow) => {
    pen.beginPath();
    pen.moveTo(size / 2, 8 - grow);
    pen.lineTo(size - 8 + grow, size - 10 + grow / 2);
    pen.lineTo(8 - grow, size - 10 + grow / 2);
    pen.closePath();
    pen.fill();
  };
  pen.fillStyle = ink().ground;
  shape(6);
  pen.fillStyle = ink().beacon;
  shape(-3);
  return new CanvasTexture(canvas);
}

export class MissionMap {
  /** `onFrame` is called after each frame. Throws where the browser has no WebGL. */
  constructor(container, onFrame) {
    this.container = container;
    this.onFrame = onFrame;
    this.renderer = new WebGLRenderer({ antialias: true, preserveDrawingBuffer: true, powerPreference: 'low-power' });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.canvas = this.renderer.domElement;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute('aria-label', 'Map. Drag to turn, wheel to zoom, right button or arrow keys to move, T from above, R as at first');
    this.canvas.setAttribute('role', 'img');
    this.tip = h('div', { class: 'tip', role: 'status', hidden: true });
    this.bar = h('div', { class: 'bar', 'aria-hidden': 'true' }, h('span'));
    container.append(this.canvas, this.bar, this.tip);
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(40, 1, 0.1, 10000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.screenSpacePanning = true;
    this.controls.maxPolarAngle = Math.PI * 0.499;
    this.controls.listenToKeyEvents(this.canvas);
    this.controls.keyPanSpeed = 20;
    this.controls.zoomToCursor = true;
    this.controls.addEventListener('change', () => this.draw());
    this.canvas.addEventListener('keydown', (event) => {
      if (event.key === 't') this.view('top');
      else if (event.key === 'r') this.view('start');
      else if (event.key === '+' || event.key === '-') this.zoom(event.key === '+' ? 0.8 : 1.25);
    });
    this.canvas.addEventListener('pointermove', (event) => this.point(event));
    this.canvas.addEventListener('pointerdown', (event) => (this.pressed = [event.clientX, event.clientY]));
    this.canvas.addEventListener('click', (event) => this.pick(event));
    this.canvas.addEventListener('pointerleave', () => (this.tip.hidden = true));
    this.groups = {};
    new ResizeObserver(() => this.resize()).observe(container);
  }

  show(scene, shown, colourBy) {
    this.data = scene;
    this.build(shown, colourBy);
    this.view('start');
  }

  /** Everything anew: also when the page turns dark. */
  build(shown, colourBy) {
    for (const group of Object.values(this.groups)) {
      group.traverse((object) => {
        object.geometry?.dispose();
        object.material?.map?.dispose();
        object.material?.dispose();
      });
      this.scene.remove(group);
    }
    this.groups = {};
    this.scene.background = new Color(ink().ground);
    const builders = {
      points: () => this.points(), optimized: () => this.paths('optimized', { width: 3.2 }),
      odometry: () => this.paths('odometry', { width: 1.6, dashed: true }),
      truth: () => this.paths('truth', { width: 7, colour: ink().truth, opacity: 0.28 }),
      reference: () => this.paths('reference', { width: 1.6, colour: ink().soft, dashed: true }),
      kept: () => this.pairs(this.data.candidates.kept, ink().kept, 1.4, 0.75),
      outlier: () => this.pairs(this.data.candidates.outlier, ink().outlier, 1.6, 0.9),
      rejected: () => this.pairs(this.data.candidates.rejected, ink().rejected, 1, 0.35),
      selected: () => this.pairs(this.data.candidates.selected, ink().selected, 1, 0.5),
      beacons: () => this.beacons(), radio: () => this.pairs(this.data.radio, ink().radio, 1, 0.6),
    };
    const order = ['points', 'truth', 'reference', 'selected', 'rejected', 'radio', 'odometry', 'kept', 'outlier', 'optimized', 'beacons'];
    this.box = this.bounds();
    for (const { id } of layersOf(this.data)) {
      const group = builders[id]();
      group.renderOrder = order.indexOf(id);
      group.traverse((object) => (object.renderOrder = order.indexOf(id)));
      group.visible = shown[id] !== false;
      this.groups[id] = group;
      this.scene.add(group);
    }
    this.colour(colourBy);
  }

  setLayer(id, on) {
    if (this.groups[id]) this.groups[id].visible = on;
    this.draw();
  }

  bounds() {
    const low = new Vector3(Infinity, Infinity, Infinity);
    const high = low.clone().negate();
    const p = new Vector3();
    for (const one of [this.data.nodes.optimized, this.data.nodes.odometry]) {
      for (let i = 0; one && i < one.length; i += 3) {
        if (!isNumber(one[i])) continue;
        p.set(one[i], one[i + 1], one[i + 2]);
        low.min(p);
        high.max(p);
      }
    }
    if (low.x > high.x) return { centre: new Vector3(), size: new Vector3(10, 10, 1) };
    return { centre: low.clone().add(high).multiplyScalar(0.5), size: high.clone().sub(low), low, high };
  }

  points() {
    const { points } = this.data;
    const geometry = new BufferGeometry();
    const positions = new Float32Array(points.position.length);
    for (let i = 0; i < positions.length; ++i) positions[i] = points.low[i % 3] + points.position[i] * points.step[i % 3];
    geometry.setAttribute('position', new BufferAttribute(positions, 3));
    geometry.setAttribute('color', new BufferAttribute(new Uint8Array(positions.length), 3, true));
    const size = points.drawn > 60000 ? 1.5 : 2.2;
    const material = new PointsMaterial({ size: size * this.renderer.getPixelRatio(), sizeAttenuation: false, vertexColors: true, transparent: true, opacity: 0.6, depthWrite: false });
    const group = new Group();
    this.cloud = new Points(geometry, material);
    group.add(this.cloud);
    return group;
  }

  /** By 'height', 'robot' or 'observability'. */
  colour(by) {
    if (!this.data.points) return this.draw();
    const { points } = this.data;
    const colours = this.cloud.geometry.getAttribute('color');
    const z = [];
    const every = Math.max(1, Math.floor(points.drawn / 5000));
    for (let i = 0; i < points.drawn; i += every) z.push(points.position[3 * i + 2]);
    z.sort((a, b) => a - b);
    const low = z[Math.floor(0.02 * (z.length - 1))] ?? 0;
    const high = Math.max(low + 1, z[Math.floor(0.98 * (z.length - 1))] ?? 1);
    this.heights = [low, high].map((q) => points.low[2] + q * points.step[2]);
    const robots = this.data.robots.map((_, i) => rgb(robotColour(i)));
    const unknown = rgb(ink().rejected);
    for (let i = 0; i < points.drawn; ++i) {
      let c;
      if (by === 'robot') c = robots[points.robot[i]] ?? unknown;
      else if (by === 'observability') c = points.observability[i] === 255 ? unknown : scale(points.observability[i] / 254);
      else c = scale((points.position[3 * i + 2] - low) / (high - low));
      colours.setXYZ(i, c[0] / 255, c[1] / 255, c[2] / 255);
    }
    colours.needsUpdate = true;
    this.cloud.material.opacity = by === 'observability' ? 0.85 : 0.6;
    this.draw();
  }

  paths(which, { width, dashed = false, colour, opacity = 1 }) {
    const group = new Group();
    const { nodes } = this.data;
    const positions = nodes[which];
    ranges(nodes).forEach(([from, to], robot) => {
      const path = [];
      for (let i = from; i < to; ++i) {
        if ((i - from) % nodes.stride !== 0 && i + 1 !== to) continue;
        if (isNumber(positions[3 * i])) path.push(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]);
      }
      if (path.length < 6) return;
      const geometry = new LineGeometry();
      geometry.setPositions(path);
      const extent = Math.max(this.box.size.x, this.box.size.y, 1);
      const material = new LineMaterial({ color: colour ?? robotColour(robot), linewidth: width, transparent: true, opacity, depthTest: false, depthWrite: false, dashed, dashSize: extent / 110, gapSize: extent / 160 });
      const line = new Line2(geometry, material);
      if (dashed) line.computeLineDistances();
      group.add(line);
    });
    return group;
  }

  pairs(layer, colour, width, opacity) {
    const group = new Group();
    const { optimized } = this.data.nodes;
    const ends = layer.ends;
    const positions = new Float32Array(3 * ends.length);
    for (let i = 0; i < ends.length; ++i) {
      for (let axis = 0; axis < 3; ++axis) positions[3 * i + axis] = optimized[3 * ends[i] + axis];
    }
    if (ends.length === 0) return group;
    if (ends.length <= 2 * kFat && width > 1) {
      const geometry = new LineSegmentsGeometry();
      geometry.setPositions(positions);
      group.add(new LineSegments2(geometry, new LineMaterial({ color: colour, linewidth: width, transparent: true, opacity, depthTest: false, depthWrite: false })));
      return group;
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(positions, 3));
    const faint = opacity * Math.min(1, Math.max(0.25, Math.sqrt(3000 / layer.drawn)));
    group.add(new LineSegments(geometry, new LineBasicMaterial({ color: colour, transparent: true, opacity: faint, depthTest: false, depthWrite: false })));
    return group;
  }

  beacons() {
    const group = new Group();
    const positions = new Float32Array(this.data.beacons.flatMap(({ node }) => [0, 1, 2].map((axis) => this.data.nodes.optimized[3 * node + axis])));
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(positions, 3));
    group.add(new Points(geometry, new PointsMaterial({ size: 17 * this.renderer.getPixelRatio(), sizeAttenuation: false, map: triangle(), transparent: true, alphaTest: 0.1, depthTest: false })));
    return group;
  }

  /** 'start' looks down at a slant, 'top' straight down with north up. All nodes are in sight. */
  view(which) {
    this.resize(false);
    const { centre, size } = this.box;
    const tilt = which === 'top' ? 0.0001 : 0.65;
    // From the south, or from the east if the map fits better so.
    const long = this.camera.aspect > 1 ? size.y > 1.15 * size.x : size.x > 1.15 * size.y;
    const turn = which !== 'top' && long ? Math.PI / 2 : 0;
    const back = new Vector3(Math.sin(turn) * Math.sin(tilt), -Math.cos(turn) * Math.sin(tilt), Math.cos(tilt));
    const { optimized, odometry, count } = this.data.nodes;
    const every = Math.max(1, Math.floor(count / 500));
    const seen = [];
    for (const one of [optimized, odometry]) {
      for (let i = 0; one && i < count; i += every) if (isNumber(one[3 * i])) seen.push(new Vector3().fromArray(one, 3 * i));
    }
    const target = centre.clone();
    const wall = 6; // a scan reaches beyond its node
    let distance = Math.max(size.length(), 10);
    const p = new Vector3();
    for (let pass = 0; pass < 12; ++pass) {
      this.camera.position.copy(target).addScaledVector(back, distance);
      this.camera.lookAt(target);
      this.camera.updateMatrixWorld();
      let [left, right, bottom, top] = [Infinity, -Infinity, Infinity, -Infinity];
      for (const node of seen) {
        p.copy(node).project(this.camera);
        left = Math.min(left, p.x);
        right = Math.max(right, p.x);
        bottom = Math.min(bottom, p.y);
        top = Math.max(top, p.y);
      }
      if (left > right) break;
      const half = distance * Math.tan((this.camera.fov * Math.PI) / 360); // of the screen's height at the target, m
      const across = new Vector3().setFromMatrixColumn(this.camera.matrixWorld, 0);
      const up = new Vector3().setFromMatrixColumn(this.camera.matrixWorld, 1);
      target.addScaledVector(across, ((left + right) / 2) * half * this.camera.aspect).addScaledVector(up, ((bottom + top) / 2) * half);
      const fill = Math.max((right - left) / 2 + wall / (half * this.camera.aspect), (top - bottom) / 2 + wall / half);
      distance = Math.max(8, distance * (0.3 + (0.7 * fill) / 0.96));
    }
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(back, distance);
    this.camera.near = distance / 500;
    this.camera.far = distance * 30;
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.draw();
  }

  zoom(factor) {
    this.camera.position.sub(this.controls.target).multiplyScalar(factor).add(this.controls.target);
    this.controls.update();
    this.draw();
  }

  resize(draw = true) {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (width === 0 || height === 0 || (this.width === width && this.height === height)) return;
    const first = this.width === undefined;
    this.width = width;
    this.height = height;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (draw && !first) this.draw();
  }

  draw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      if (this.data && this.width) {
        this.renderer.render(this.scene, this.camera);
        this.scaleBar();
        this.onFrame?.();
      }
    });
  }

  /** A round length at the distance of what is looked at. */
  scaleBar() {
    const distance = this.camera.position.distanceTo(this.controls.target);
    const perPixel = (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360)) / this.height;
    const wanted = 130 * perPixel;
    let length = 10 ** Math.floor(Math.log10(wanted));
    for (const factor of [5, 2]) {
      if (factor * length <= wanted) {
        length *= factor;
        break;
      }
    }
    this.bar.style.width = `${length / perPixel}px`;
    this.bar.firstChild.textContent = `${length >= 1 ? length : length.toPrecision(1)} m`;
  }

  /** Shows one pair in bold. */
  markPair(from, to) {
    if (this.groups.marked) this.scene.remove(this.groups.marked);
    const group = this.pairs({ ends: [from, to], drawn: 1 }, ink().text, 4, 1);
    group.traverse((object) => (object.renderOrder = 20));
    this.groups.marked = group;
    this.scene.add(group);
    this.draw();
  }

  /** A click on a closure calls `onPair` with its nodes; the end of a drag is no click. */
  pick(event) {
    const moved = this.pressed && Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) > 4;
    if (!this.data || !this.onPair || moved) return;
    const frame = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - frame.left, event.clientY - frame.top];
    const p = new Vector3();
    const onScreen = (node) => {
      p.fromArray(this.data.nodes.optimized, 3 * node).project(this.camera);
      return p.z < 1 ? [((p.x + 1) / 2) * frame.width, ((1 - p.y) / 2) * frame.height] : null;
    };
    let best = 10;
    let found = null;
    for (const { from, to } of this.data.review?.closures ?? []) {
      const [a, b] = [onScreen(from), onScreen(to)];
      if (!a || !b) continue;
      const along = [b[0] - a[0], b[1] - a[1]];
      const share = Math.min(1, Math.max(0, ((x - a[0]) * along[0] + (y - a[1]) * along[1]) / Math.max(1e-9, along[0] ** 2 + along[1] ** 2)));
      const off = Math.hypot(x - a[0] - share * along[0], y - a[1] - share * along[1]);
      if (off < best) [best, found] = [off, [from, to]];
    }
    if (found) this.onPair(...found);
  }

  /** Tells of the node under the pointer. */
  point(event) {
    if (!this.data || event.buttons !== 0 || !this.groups.optimized?.visible) {
      this.tip.hidden = true;
      return;
    }
    const { nodes, robots } = this.data;
    const frame = this.canvas.getBoundingClientRect();
    const p = new Vector3();
    let best = 12 * 12;
    let found = -1;
    let where;
    for (let i = 0; i < nodes.count; ++i) {
      p.fromArray(nodes.optimized, 3 * i).project(this.camera);
      const x = ((p.x + 1) / 2) * frame.width;
      const y = ((1 - p.y) / 2) * frame.height;
      const off = (x - (event.clientX - frame.left)) ** 2 + (y - (event.clientY - frame.top)) ** 2;
      if (p.z < 1 && off < best) {
        best = off;
        found = i;
        where = [x, y];
      }
    }
    this.tip.hidden = found < 0;
    if (found < 0) return;
    const robot = ranges(nodes).findIndex(([from, to]) => found >= from && found < to);
    const off = (one) => one && nodes.truth && Math.hypot(...[0, 1, 2].map((axis) => one[3 * found + axis] - nodes.truth[3 * found + axis]));
    const facts = [
      nodes.time_s && isNumber(nodes.time_s[found]) && `${fixed(nodes.time_s[found], 0)} s`,
      isNumber(off(nodes.optimized)) && `error ${metres(off(nodes.optimized))}`,
      isNumber(off(nodes.odometry)) && `by odometry ${metres(off(nodes.odometry))}`,
      nodes.observability && isNumber(nodes.observability[found]) && `observability ${fixed(nodes.observability[found], 2)}`,
    ].filter(Boolean);
    this.tip.replaceChildren(h('strong', {}, `${robots[robot]} · ${nodes.key[found]}`), h('br'), facts.join(' · '));
    this.tip.style.left = `${Math.min(where[0] + 14, frame.width - 240)}px`;
    this.tip.style.top = `${Math.max(4, where[1] - 50)}px`;
  }
}
