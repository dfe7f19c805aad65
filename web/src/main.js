// SPDX-License-Identifier: BSD-3-Clause
// The report: summary, map, charts, tables. `window.loopwiseReport` tells tests what is on the screen.
import { at, count, duration, fixed, h, isNumber, metres, percent } from './dom.js';
import { readData } from './data.js';
import { layersOf, MissionMap } from './map.js';
import { MissionPlan } from './plan.js';
import { Review } from './review.js';
import { drawCharts } from './charts.js';
import { pairedTable, runCount, studyFigures, studyTables } from './studies.js';
import { allRuns, comparison, provenance, runTables } from './tables.js';
import { robotColour, scaleGradient } from './palette.js';

const state = { ready: false, firstFrameMs: null, frames: 0, layers: {}, colourBy: 'height', charts: {}, errors: [], run: null };
window.loopwiseReport = state;
addEventListener('error', (event) => state.errors.push(event.message));
addEventListener('unhandledrejection', (event) => state.errors.push(String(event.reason)));

const root = document.getElementById('report');

function fail(message) {
  root.replaceChildren(h('p', { class: 'failure' }, message));
  state.ready = true;
}

const hasWebGl = () => Boolean(document.createElement('canvas').getContext('webgl2'));
const shownLayers = {};
let colourBy = 'height';
let map = null;

const figure = (label, value, detail) => h('div', { class: 'figure' }, h('dt', {}, label), h('dd', {}, h('span', { class: 'value' }, value), h('span', { class: 'detail' }, detail)));

function keyFigures(run) {
  const s = run.summary;
  const { candidates: c = {}, closures: k = {} } = s;
  const before = at(s, 'ate_m', 'odometry');
  const after = at(s, 'ate_m', 'optimized');
  const residual = (which) => at(s, 'residuals', which, 'translation_m', 'median');
  const length = Object.values(s.robots ?? {}).reduce((sum, robot) => sum + (robot.path_length_m ?? 0), 0);
  const robots = Object.keys(s.robots ?? {}).length;
  return h('dl', { class: 'figures' },
    isNumber(after) && figure(`Mean position error${at(s, 'truth', 'alignment') === 'se3' ? ', aligned' : ''}`, metres(after), isNumber(before) && before > 1e-6 ? `${metres(before)} by odometry: ${after <= before ? '−' : '+'}${Math.abs(100 - (100 * after) / before).toFixed(0)} %` : ''),
    figure('Closures kept', count(k.gnc_inliers), `of ${count(k.verified)} verified${isNumber(k.true_inliers) ? `; ${count(k.true_inliers)} are true` : ''}`),
    !isNumber(after) && figure('Residual of kept closures', metres(residual('optimized')), isNumber(residual('optimized')) ? `median; ${metres(residual('odometry'))} by odometry` : 'not known'),
    figure('Candidates computed', count(c.computed), `${percent(c.computed, c.queued)} of ${count(c.queued)} queued`),
    figure('Mission', duration(isNumber(run.end_s) ? run.end_s : s.mission_time_s), `${robots} robot${robots === 1 ? '' : 's'}, ${count(s.key_frames)} key frames${length > 0 ? `, ${length >= 2000 ? `${(length / 1000).toFixed(1)} km` : `${fixed(length, 0)} m`}` : ''}`));
}

function swatch(layer, scene) {
  const { swatch: s } = layer;
  if (s.mark) return h('span', { class: 'swatch mark', 'aria-hidden': 'true' }, s.mark);
  if (s.scale) return h('span', { class: 'swatch dots', 'aria-hidden': 'true' });
  const colours = s.line === 'robot' ? scene.robots.map((_, i) => robotColour(i)) : [s.line];
  return h('span', { class: 'swatch', 'aria-hidden': 'true' }, colours.slice(0, 4).map((colour) => h('i', { style: `border-top: ${Math.min(5, s.width ?? 2)}px ${s.dashed ? 'dashed' : 'solid'} ${colour}; opacity: ${s.faint ? 0.4 : 1}` })));
}

function legend(scene) {
  state.layers = {};
  const rows = layersOf(scene).map((layer) => {
    shownLayers[layer.id] ??= layer.on;
    state.layers[layer.id] = { total: layer.total, drawn: layer.drawn, on: shownLayers[layer.id] };
    const total = layer.drawn < layer.total ? `${count(layer.drawn)} of ${count(layer.total)}` : count(layer.total);
    return h('label', { class: 'layer', title: `${count(layer.total)} ${layer.unit}${layer.drawn < layer.total ? `, ${count(layer.drawn)} of them drawn, chosen at random` : ''}` },
      h('input', {
        type: 'checkbox', 'data-layer': layer.id, checked: shownLayers[layer.id],
        onchange: (event) => {
          shownLayers[layer.id] = event.target.checked;
          state.layers[layer.id].on = event.target.checked;
          map?.setLayer(layer.id, event.target.checked);
        },
      }), swatch(layer, scene), h('span', { class: 'name' }, layer.label), h('span', { class: 'total' }, total));
  });
  const robots = h('ul', { class: 'robots' }, scene.robots.map((name, i) => h('li', {}, h('i', { style: `background: ${robotColour(i)}` }), name)));
  const hasScores = scene.points && scene.points.observability.some((value) => value !== 255);
  const modes = [['height', 'height'], ['robot', 'robot'], hasScores && ['observability', 'observability']].filter(Boolean);
  if (!modes.some(([id]) => id === colourBy)) colourBy = 'height';
  const key = h('div', { class: 'scale', id: 'scale' });
  const showKey = () => {
    const [low, high] = colourBy === 'height' && map?.heights ? map.heights.map((z) => `${z.toFixed(1)} m`) : colourBy === 'observability' ? ['0', '1'] : [];
    key.replaceChildren(...(low ? [h('span', {}, low), h('span', { class: 'gradient', style: `background: ${scaleGradient()}` }), h('span', {}, high)] : []));
  };
  const colours = scene.points && !map?.isPlan && h('fieldset', {}, h('legend', {}, 'Colour points by'), h('div', { class: 'choices' }, modes.map(([id, label]) => h('label', {}, h('input', {
    type: 'radio', name: 'colour', value: id, checked: colourBy === id,
    onchange: () => {
      colourBy = state.colourBy = id;
      map?.colour(id);
      showKey();
    },
  }), label))), key);
  state.colourBy = colourBy;
  queueMicrotask(showKey);
  return h('div', { class: 'legend' }, h('fieldset', {}, h('legend', {}, 'Layers'), rows), h('fieldset', {}, h('legend', {}, 'Robots'), robots), colours,
    !map?.isPlan && h('div', { class: 'views' }, h('button', { type: 'button', onclick: () => map?.view('start') }, 'Whole map'), h('button', { type: 'button', onclick: () => map?.view('top') }, 'From above')),
    !map?.isPlan && h('p', { class: 'hint' }, 'Drag to turn, wheel to zoom, right button or arrow keys to move. Point at a path for its nodes.'));
}

function start(data) {
  let current = data.runs.find((run) => run.scene) ?? data.runs[0] ?? null;
  const title = current ? [...new Set(data.runs.map((run) => run.mission))].filter(Boolean).slice(0, 3).join(', ') : data.studies.map((study) => study.label).join(', ');
  document.title = `${title} · Loopwise report`;
  const chosen = data.runs.length > 1 && h('label', { class: 'chosen' }, 'Run ', h('select', { id: 'run', onchange: (event) => select(Number(event.target.value)) }, data.runs.map((run) => h('option', { value: run.index, selected: run === current }, `${run.name}${run.scene ? '' : ' (no map)'}`))));
  const figures = h('div', { id: 'figures' });
  const mapBox = h('div', { class: 'map', id: 'map' });
  const side = h('div', { id: 'legend' });
  const mapRow = h('section', { class: 'maprow card', 'aria-label': 'Map' }, mapBox, side);
  const review = new Review(state, (closure) => map?.markPair?.(closure.from, closure.to));
  const charts = h('section', { class: 'cards charts', 'aria-label': 'Charts' });
  const tables = h('div', { class: 'cards' });
  const origin = h('div', { id: 'provenance' });
  const subtitle = h('p', { class: 'subtitle' });
  const compared = comparison(data, (index) => select(index));
  root.replaceChildren(
    h('header', {}, h('div', {}, h('h1', {}, title || 'Loopwise report'), subtitle), chosen),
    figures, mapRow, review.element, charts,
    h('section', {}, (compared || data.studies.length > 0) && h('h2', {}, 'Comparison'), compared && h('div', { class: 'card' }, compared), data.studies.flatMap((study) => [...studyTables(study), pairedTable(study), allRuns(study)])),
    h('section', {}, current && h('h2', {}, 'Figures of the run'), tables),
    h('section', {}, h('h2', {}, 'Configuration and provenance'), origin),
    h('footer', {}, data.generator, ' report. This page loads nothing from the network.'));

  function showMap() {
    mapRow.hidden = !current?.scene;
    if (!current?.scene) return review.show(null);
    const scene = current.decoded;
    const onFrame = () => {
      state.frames += 1;
      state.firstFrameMs ??= performance.now();
    };
    try {
      map ??= hasWebGl() ? new MissionMap(mapBox, onFrame) : new MissionPlan(mapBox, onFrame);
    } catch {
      map = new MissionPlan(mapBox, onFrame);
    }
    const box = legend(scene);
    map?.show(scene, shownLayers, colourBy);
    side.replaceChildren(box);
    state.map = map;
    if (map) map.onPair = (from, to) => review.selectPair(from, to);
    review.show(scene);
  }

  function showText() {
    if (!current) {
      const studies = `${data.studies.length} stud${data.studies.length === 1 ? 'y' : 'ies'}`;
      subtitle.textContent = `${studies}, ${count(data.studies.reduce((sum, study) => sum + runCount(study), 0))} runs`;
      if (data.studies.length > 0) figures.replaceChildren(h('dl', { class: 'figures' }, studyFigures(data.studies[0]).map((one) => figure(...one))));
      return;
    }
    const parts = [`method ${current.method}`, `seed ${current.summary.seed ?? '–'}`];
    if (data.runs.length > 1) parts.push(`${data.runs.length} runs`);
    if (current.summary.interrupted) parts.push('interrupted');
    subtitle.textContent = parts.join(' · ');
    figures.replaceChildren(keyFigures(current));
    tables.replaceChildren(...runTables(current));
    for (const row of root.querySelectorAll('tr[data-run]')) row.classList.toggle('current', Number(row.dataset.run) === current.index);
    const select = root.querySelector('#run');
    if (select) select.value = String(current.index);
    state.run = current.index;
  }

  async function showRest() {
    state.ready = false;
    origin.replaceChildren(...provenance(data, current).flat().filter(Boolean));
    await drawCharts(charts, data, current, state.charts);
    state.ready = true;
  }

  function select(index) {
    current = data.runs[index];
    showText();
    showMap();
    showRest();
  }

  showText();
  showMap();
  // The map's first frame comes before the charts are made.
  const later = () => setTimeout(showRest, 0);
  if (map) requestAnimationFrame(() => requestAnimationFrame(later));
  else later();
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
    if (current?.scene) {
      side.replaceChildren(legend(current.decoded));
      map?.build(shownLayers, colourBy);
      review.redraw();
    }
    drawCharts(charts, data, current, state.charts);
  });
}

try {
  start(readData(document.getElementById('data').textContent));
} catch (error) {
  state.errors.push(String(error));
  fail(`This report cannot be read: ${error.message}`);
}
