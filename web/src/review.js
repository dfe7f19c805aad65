// SPDX-License-Identifier: BSD-3-Clause
// Review of closures by a person: both scans laid on each other, and a decision for decisions.csv.
import { count, duration, fixed, h, isNumber, metres, percent } from './dom.js';
import { dark, ink } from './palette.js';

const kLayings = [['odometry', 'odometry'], ['registration', 'the registration'], ['estimate', 'the estimate']];
const kWords = { accept: 'accepted', reject: 'rejected' };
const kMargin = 0.06; // of the drawing

/** Decisions of all runs of a page: they hold for the mission. */
const decisions = new Map();
const pairOf = (closure) => [...closure.keys].sort().join(',');

/** Text of decisions.csv. Keys are decimal numbers: they are longer than numbers of this language hold. */
export const decisionsText = () => ['from,to,decision', ...[...decisions.values()].map(({ keys, word }) => `${keys.join(',')},${word}`), ''].join('\n');

/** A scan's points in the frame of `from`: [x, y, z, x, …]. `T` is a 3x4 matrix, row by row. */
function placed(scan, T) {
  const out = new Float32Array(scan.points.length);
  for (let i = 0; i < out.length; i += 3) {
    const p = [0, 1, 2].map((axis) => scan.low[axis] + scan.points[i + axis] * scan.step[axis]);
    for (let row = 0; row < 3; ++row) out[i + row] = T ? T[4 * row] * p[0] + T[4 * row + 1] * p[1] + T[4 * row + 2] * p[2] + T[4 * row + 3] : p[row];
  }
  return out;
}

/** Two clouds along two axes, in one scale. */
function draw(canvas, clouds, across, up) {
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  const width = canvas.clientWidth || 320;
  const height = canvas.clientHeight || 240;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = canvas.getContext('2d');
  pen.scale(ratio, ratio);
  const low = [Infinity, Infinity];
  const high = [-Infinity, -Infinity];
  for (const { points } of clouds) {
    for (let i = 0; i < points.length; i += 3) {
      [across, up].forEach((axis, k) => {
        low[k] = Math.min(low[k], points[i + axis]);
        high[k] = Math.max(high[k], points[i + axis]);
      });
    }
  }
  const scale = (1 - 2 * kMargin) * Math.min(width / Math.max(1, high[0] - low[0]), height / Math.max(1, high[1] - low[1]));
  const middle = [0, 1].map((k) => (low[k] + high[k]) / 2);
  for (const { points, colour } of clouds) {
    pen.fillStyle = colour;
    for (let i = 0; i < points.length; i += 3) pen.fillRect(width / 2 + (points[i + across] - middle[0]) * scale - 0.8, height / 2 - (points[i + up] - middle[1]) * scale - 0.8, 1.6, 1.6);
  }
}

const coloursOf = () => (dark() ? ['#4aa8e0', '#f0b429'] : ['#0072b2', '#d55e00']);

export class Review {
  /** `state` tells tests what is on the screen; `onSelect` is called with the closure that is looked at. */
  constructor(state, onSelect) {
    this.state = state;
    this.onSelect = onSelect;
    this.laying = 'registration';
    this.element = h('section', { class: 'review card', 'aria-label': 'Review of closures', id: 'review' });
    new ResizeObserver(() => this.redraw()).observe(this.element);
  }

  show(scene) {
    this.scene = scene;
    this.review = scene?.review ?? null;
    this.element.hidden = !this.review;
    this.state.review = null;
    if (!this.review) return;
    this.selected = 0;
    this.build();
  }

  name(closure) {
    const { key } = this.scene.nodes;
    return `${key[closure.from]} – ${key[closure.to]}`;
  }

  build() {
    const { closures, total } = this.review;
    this.rows = closures.map((closure, i) => h('button', { type: 'button', class: 'closure', 'data-closure': i, onclick: () => this.select(i) },
      h('span', { class: 'name' }, this.name(closure)), h('span', { class: 'off' }, metres(closure.off_m)), h('span', { class: 'word' })));
    this.canvases = ['From above', 'From the side'].map((label) => h('canvas', { role: 'img', 'aria-label': `${label}: both scans` }));
    this.facts = h('p', { class: 'facts', role: 'status' });
    this.layings = h('div', { class: 'choices' });
    this.buttons = h('div', { class: 'views' }, [['accept', 'Accept'], ['reject', 'Reject'], ['', 'No decision']].map(([word, label]) => h('button', { type: 'button', 'data-decide': word, onclick: () => this.decide(word) }, label)));
    this.save = h('button', { type: 'button', id: 'save-decisions', onclick: () => this.download() });
    this.element.replaceChildren(
      h('div', { class: 'list' },
        h('h3', {}, 'Review of closures'),
        h('p', { class: 'hint' }, `${count(closures.length)} of ${count(total)} verified closures, the most doubtful first: left out by robust optimisation, or far from the estimate. Click a closure here or in the map.`),
        h('div', { class: 'closures' }, this.rows)),
      h('div', { class: 'look' }, this.facts, h('fieldset', {}, h('legend', {}, 'Scans laid on each other by'), this.layings), h('div', { class: 'scans' }, this.canvases),
        this.buttons, h('div', { class: 'views' }, this.save),
        h('p', { class: 'hint' }, 'The saved file is for loopwise optimize or replay, option --decisions: rejected closures are left out, accepted ones are never doubted.')));
    this.select(0, false);
  }

  select(index, tell = true) {
    this.selected = index;
    const closure = this.review.closures[index];
    this.rows.forEach((row, i) => row.setAttribute('aria-current', String(i === index)));
    const known = kLayings.filter(([id]) => closure[id]);
    if (!known.some(([id]) => id === this.laying)) this.laying = 'registration';
    this.layings.replaceChildren(...known.map(([id, label]) => h('label', {}, h('input', { type: 'radio', name: 'laying', value: id, checked: id === this.laying, onchange: () => this.lay(id) }), label)));
    const kept = closure.weight > 0.5;
    this.facts.replaceChildren(h('strong', {}, this.name(closure)), h('br'), [
      kept ? 'kept' : 'left out by robust optimisation', isNumber(closure.overlap) && `overlap ${percent(closure.overlap, 1)}`,
      `${metres(closure.off_m)} and ${fixed(closure.off_deg, 1)}° from the estimate`, isNumber(closure.time_s) && `after ${duration(closure.time_s)}`,
    ].filter(Boolean).join(' · '));
    this.mark();
    this.redraw();
    if (tell) this.onSelect?.(closure);
  }

  lay(id) {
    this.laying = id;
    this.state.review.laying = id;
    this.redraw();
  }

  decide(word) {
    const closure = this.review.closures[this.selected];
    if (word) decisions.set(pairOf(closure), { keys: closure.keys, word });
    else decisions.delete(pairOf(closure));
    this.mark();
  }

  /** Shows what has been decided. */
  mark() {
    this.review.closures.forEach((closure, i) => {
      const word = decisions.get(pairOf(closure))?.word;
      this.rows[i].querySelector('.word').textContent = word ? kWords[word] : closure.weight > 0.5 ? '' : 'left out';
      this.rows[i].dataset.word = word ?? '';
    });
    const now = decisions.get(pairOf(this.review.closures[this.selected]))?.word ?? '';
    for (const button of this.buttons.querySelectorAll('button')) button.setAttribute('aria-pressed', String(button.dataset.decide === now));
    this.save.textContent = `Save decisions.csv (${count(decisions.size)})`;
    this.save.disabled = decisions.size === 0;
    this.state.review = { selected: this.selected, laying: this.laying, decisions: decisions.size, csv: decisionsText() };
  }

  redraw() {
    if (!this.review || !this.canvases?.[0].isConnected) return;
    const closure = this.review.closures[this.selected];
    const colours = coloursOf();
    const clouds = [{ points: placed(this.review.scans[closure.from], null), colour: colours[0] }, { points: placed(this.review.scans[closure.to], closure[this.laying]), colour: colours[1] }];
    draw(this.canvases[0], clouds, 0, 1);
    draw(this.canvases[1], clouds, 0, 2);
    for (const canvas of this.canvases) canvas.style.background = ink().ground;
  }

  download() {
    const link = h('a', { href: URL.createObjectURL(new Blob([decisionsText()], { type: 'text/csv' })), download: 'decisions.csv' });
    link.click();
    URL.revokeObjectURL(link.href);
  }

  /** Selects the closure between two nodes, if it is in the review. */
  selectPair(from, to) {
    const index = this.review?.closures.findIndex((closure) => closure.from === from && closure.to === to) ?? -1;
    if (index < 0) return;
    this.select(index);
    this.rows[index].scrollIntoView({ block: 'nearest' });
  }
}
