// SPDX-License-Identifier: BSD-3-Clause
// The map of a run from above as SVG, for browsers without WebGL.
import { layersOf, ranges } from './map.js';
import { ink, robotColour } from './palette.js';
import { h, isNumber } from './dom.js';

const kPoints = 6000; // a plan need not show more
const kMargin = 6; // m: a scan reaches beyond its node

const svg = (name, attributes, ...children) => {
  const element = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  element.append(...children);
  return element;
};
const line = (d, colour, width, more = {}) => svg('path', { d, fill: 'none', stroke: colour, 'stroke-width': width, 'stroke-linejoin': 'round', 'vector-effect': 'non-scaling-stroke', ...more });
const at = (positions, i) => `${positions[3 * i].toFixed(2)} ${(-positions[3 * i + 1]).toFixed(2)}`;

/** Draws what MissionMap draws, without turning and zooming. */
export class MissionPlan {
  constructor(container, onFrame) {
    this.isPlan = true;
    this.onFrame = onFrame;
    this.svg = svg('svg', { role: 'img', 'aria-label': 'Plan of the map, north up' });
    this.bar = h('div', { class: 'bar', 'aria-hidden': 'true' }, h('span'));
    container.append(this.svg, this.bar, h('p', { class: 'plannote' }, 'From above: this browser has no WebGL.'));
    this.container = container;
    this.groups = {};
    new ResizeObserver(() => this.scaleBar()).observe(container);
  }

  show(scene, shown) {
    this.data = scene;
    this.build(shown);
  }

  /** Everything anew: also when the page turns dark. */
  build(shown) {
    const colours = ink();
    const { candidates } = this.data;
    const builders = {
      points: () => [this.points()], optimized: () => this.paths('optimized', 3), odometry: () => this.paths('odometry', 1.6, { 'stroke-dasharray': '7 5' }),
      truth: () => this.paths('truth', 7, { stroke: colours.truth, opacity: 0.28 }),
      reference: () => this.paths('reference', 1.6, { stroke: colours.soft, 'stroke-dasharray': '1.5 3.5' }),
      kept: () => [this.pairs(candidates.kept, colours.kept, 0.75)], outlier: () => [this.pairs(candidates.outlier, colours.outlier, 0.9)],
      rejected: () => [this.pairs(candidates.rejected, colours.rejected, 0.35)], selected: () => [this.pairs(candidates.selected, colours.selected, 0.5)],
      beacons: () => this.beacons(), radio: () => [this.pairs(this.data.radio, colours.radio, 0.6)],
    };
    const order = ['points', 'truth', 'reference', 'selected', 'rejected', 'radio', 'odometry', 'kept', 'outlier', 'optimized', 'beacons'];
    const ids = layersOf(this.data).map(({ id }) => id).sort((a, b) => order.indexOf(a) - order.indexOf(b));
    this.fit();
    this.groups = Object.fromEntries(ids.map((id) => [id, svg('g', { 'data-layer': id, visibility: shown[id] === false ? 'hidden' : 'visible' }, ...builders[id]())]));
    this.svg.replaceChildren(...Object.values(this.groups));
    this.scaleBar();
    this.onFrame?.();
  }

  setLayer(id, on) {
    this.groups[id]?.setAttribute('visibility', on ? 'visible' : 'hidden');
  }

  /** All nodes are in sight, as in 3D. */
  fit() {
    let [left, right, bottom, top] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const one of [this.data.nodes.optimized, this.data.nodes.odometry]) {
      for (let i = 0; one && i < one.length; i += 3) {
        if (!isNumber(one[i])) continue;
        [left, right] = [Math.min(left, one[i]), Math.max(right, one[i])];
        [bottom, top] = [Math.min(bottom, one[i + 1]), Math.max(top, one[i + 1])];
      }
    }
    if (left > right) [left, right, bottom, top] = [-5, 5, -5, 5];
    this.size = [right - left + 2 * kMargin, top - bottom + 2 * kMargin];
    this.svg.setAttribute('viewBox', `${left - kMargin} ${-top - kMargin} ${this.size[0]} ${this.size[1]}`);
  }

  points() {
    const { points } = this.data;
    const every = Math.max(1, Math.ceil(points.drawn / kPoints));
    let d = '';
    for (let i = 0; i < points.drawn; i += every) {
      const [x, y] = [0, 1].map((axis) => points.low[axis] + points.position[3 * i + axis] * points.step[axis]);
      d += `M${x.toFixed(1)} ${(-y).toFixed(1)}h0`;
    }
    return line(d, ink().rejected, 1.6, { 'stroke-linecap': 'round', opacity: 0.7 });
  }

  paths(which, width, more = {}) {
    const { nodes, robots } = this.data;
    const positions = nodes[which];
    return ranges(nodes).map(([from, to], robot) => {
      const path = [];
      for (let i = from; i < to; ++i) {
        if (((i - from) % nodes.stride === 0 || i + 1 === to) && isNumber(positions[3 * i])) path.push(at(positions, i));
      }
      const drawn = line(path.length > 1 ? `M${path.join('L')}` : '', robotColour(robot), width, more);
      drawn.append(svg('title', {}, robots[robot]));
      return drawn;
    });
  }

  pairs(layer, colour, opacity) {
    const { optimized } = this.data.nodes;
    let d = '';
    for (let i = 0; i + 1 < layer.ends.length; i += 2) d += `M${at(optimized, layer.ends[i])}L${at(optimized, layer.ends[i + 1])}`;
    return line(d, colour, 1.2, { opacity });
  }

  beacons() {
    const { beacons, nodes } = this.data;
    return beacons.map(({ name, node }) => {
      const mark = line(`M${at(nodes.optimized, node)}h0`, ink().beacon, 10, { 'stroke-linecap': 'square' });
      mark.append(svg('title', {}, name));
      return mark;
    });
  }

  /** A round length. */
  scaleBar() {
    if (!this.size) return;
    const perPixel = Math.max(this.size[0] / this.container.clientWidth, this.size[1] / this.container.clientHeight);
    if (!(perPixel > 0) || !Number.isFinite(perPixel)) return;
    const decade = 10 ** Math.floor(Math.log10(130 * perPixel));
    const length = decade * ([5, 2].find((factor) => factor * decade <= 130 * perPixel) ?? 1);
    this.bar.style.width = `${length / perPixel}px`;
    this.bar.firstChild.textContent = `${length >= 1 ? length : length.toPrecision(1)} m`;
  }
}
