// SPDX-License-Identifier: BSD-3-Clause
// Charts over mission time and over runs, by Vega-Lite.
import embed from 'vega-embed';
import { flatOptions, noiseOf } from './data.js';
import { h, isNumber } from './dom.js';
import { ink, methodColour } from './palette.js';
import { variantOf, worldOf } from './studies.js';

const kMethods = ['odometry', 'odom', 'baseline', 'random', 'obs', 'gi', 'full', 'rssi'];
/** The order in which methods stand everywhere. */
const methodOrder = (a, b) => (kMethods.indexOf(a.split(',')[0]) + 99) % 99 - (kMethods.indexOf(b.split(',')[0]) + 99) % 99;

/** A logarithmic axis where the values span enough for several ticks: else a linear one tells more. */
function logAxis(values) {
  const positive = values.filter((value) => value > 0);
  const [low, high] = [Math.min(...positive), Math.max(...positive)];
  if (!(high >= 30 * low)) return null;
  const ticks = [];
  for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); ++e) ticks.push(...[1, 2, 5].map((f) => Number((f * 10 ** e).toPrecision(1))));
  const inside = ticks.filter((tick) => tick >= low && tick <= high);
  const decades = inside.filter((tick) => /^1(e|0*$)|^0\.0*1$/.test(String(tick)));
  return { scale: { type: 'log', nice: false }, axis: { format: '~g', values: decades.length >= 4 ? decades : inside } };
}
const kKinds = { verified: 'verified', gnc_inliers: 'kept by GNC', true_inliers: 'true' };

function config() {
  const { text, soft, line } = ink();
  return {
    background: null,
    font: 'system-ui, sans-serif',
    padding: 4,
    view: { stroke: null },
    axis: { labelColor: soft, titleColor: soft, titleFontWeight: 'normal', gridColor: line, domainColor: line, tickColor: line, labelFontSize: 12, titleFontSize: 12, titlePadding: 8 },
    legend: { labelColor: text, titleColor: soft, orient: 'top', labelFontSize: 12, symbolStrokeWidth: 3, symbolType: 'stroke', columns: 3, labelLimit: 260, title: null },
    line: { strokeWidth: 2 },
    rule: { color: soft },
    text: { color: soft },
  };
}

/** Minutes where seconds would be large numbers. */
const timeUnit = (runs) => (Math.max(0, ...runs.map((run) => run.rows.at(-1)?.mission_time_s ?? 0)) > 900 ? { unit: 'min', divide: 60 } : { unit: 's', divide: 1 });

/** Colours of series: their methods'. */
function runColours(runs) {
  const others = [];
  const domain = [...new Set(runs.map((run) => run.series))];
  const range = domain.map((series) => {
    const { method } = runs.find((run) => run.series === series);
    if (!others.includes(method)) others.push(method);
    return methodColour(method, others.indexOf(method));
  });
  return { domain, range };
}

/** The ends of the runs' missions, where known: a line each. */
function ends(runs, divide) {
  const times = [...new Set(runs.map((run) => run.end_s).filter(isNumber))];
  if (times.length === 0 || times.length > 4) return [];
  const data = { values: times.map((t) => ({ t: t / divide, label: 'mission ends' })) };
  return [
    { data, mark: { type: 'rule', strokeDash: [3, 3] }, encoding: { x: { field: 't', type: 'quantitative' } } },
    { data, mark: { type: 'text', align: 'right', dx: -5, y: 8, fontSize: 11 }, encoding: { x: { field: 't', type: 'quantitative' }, text: { field: 'label' } } },
  ];
}

function overTime(runs, columns, value, yTitle, { kinds = kKinds, colours, format = ',.3~r', wide = false } = {}) {
  const { unit, divide } = timeUnit(runs);
  const values = [];
  for (const run of runs) {
    for (const row of run.rows) {
      for (const column of columns) {
        const y = value(row, column);
        if (isNumber(y)) values.push({ run: run.name, series: run.series, kind: kinds[column], t: row.mission_time_s / divide, y });
      }
    }
  }
  if (values.length === 0) return null;
  const log = wide ? logAxis(values.map((v) => v.y)) : null;
  const several = new Set(runs.map((run) => run.series)).size > 1;
  const present = columns.map((column) => kinds[column]).filter((kind) => values.some((v) => v.kind === kind));
  const dashes = { domain: present, range: [[1, 0], [6, 3], [2, 2]].slice(0, present.length) };
  const kindColours = { domain: present, range: present.map((kind) => colours[kind]) };
  return {
    layer: [
      ...ends(runs, divide),
      {
        data: { values: log ? values.filter((v) => v.y > 0) : values },
        mark: { type: 'line', interpolate: 'step-after', clip: true },
        encoding: {
          x: { field: 't', type: 'quantitative', title: `mission time (${unit})`, axis: { grid: false }, scale: { nice: false, zero: true } },
          y: { field: 'y', type: 'quantitative', title: yTitle, ...(log ?? {}) },
          color: several ? { field: 'series', type: 'nominal', scale: runColours(runs), sort: null } : { field: 'kind', type: 'nominal', scale: kindColours, sort: null },
          ...(several && present.length > 1 ? { strokeDash: { field: 'kind', type: 'nominal', scale: dashes, sort: null } } : {}),
          detail: [{ field: 'run' }, { field: 'kind' }],
          tooltip: [
            { field: 'run', title: 'run' }, { field: 'kind', title: 'closures' },
            { field: 't', title: `time (${unit})`, format: '.1f' }, { field: 'y', title: yTitle, format },
          ],
        },
      },
    ],
  };
}

function boxes(entries, mission) {
  const values = entries.filter((entry) => entry.mission === mission);
  const methods = [...new Set(values.map((v) => v.method))];
  const range = methods.map((m, i) => methodColour(m, i));
  const sort = [...methods].sort(methodOrder);
  const y = { field: 'method', type: 'nominal', title: null, sort, axis: { labelFontSize: 13, domain: false, ticks: false } };
  const color = { field: 'method', type: 'nominal', scale: { domain: methods, range }, legend: null };
  return {
    height: 34 * methods.length,
    layer: [
      { mark: { type: 'boxplot', extent: 'min-max', size: 16, box: { fillOpacity: 0.3 }, median: { color: ink().text, strokeWidth: 2 } }, encoding: { x: { field: 'ate', type: 'quantitative', title: 'mean position error (m)', scale: { zero: true } }, y, color } },
      { mark: { type: 'point', filled: true, size: 42, opacity: 0.9 }, encoding: { x: { field: 'ate', type: 'quantitative' }, y, color, tooltip: [{ field: 'label', title: 'run' }, { field: 'method' }, { field: 'ate', title: 'mean error (m)', format: '.4f' }] } },
    ],
    data: { values },
  };
}

function robots(run) {
  const values = [];
  for (const [name, robot] of Object.entries(run.summary.robots ?? {})) {
    for (const which of ['odometry', 'optimized']) {
      const mean = robot?.[which]?.ate_m?.mean;
      const max = robot?.[which]?.ate_m?.max;
      if (isNumber(mean)) values.push({ robot: name, which: which === 'optimized' ? 'optimised' : 'odometry alone', mean, max });
    }
  }
  if (values.length === 0) return null;
  const { text } = ink();
  const y = { field: 'robot', type: 'nominal', title: null, axis: { labelLimit: 140, domain: false, ticks: false, labelFontSize: 13 } };
  const yOffset = { field: 'which', scale: { domain: ['odometry alone', 'optimised'] } };
  return {
    height: 44 * new Set(values.map((v) => v.robot)).size,
    data: { values },
    layer: [
      { mark: { type: 'bar', cornerRadiusEnd: 2, height: { band: 0.8 } }, encoding: { x: { field: 'mean', type: 'quantitative', title: 'position error (m): bar mean, line up to the largest' }, y, yOffset, color: { field: 'which', type: 'nominal', sort: null, legend: { symbolType: 'square', symbolStrokeWidth: 0 }, scale: { domain: ['odometry alone', 'optimised'], range: [methodColour('odometry'), methodColour('obs')] } }, tooltip: [{ field: 'robot' }, { field: 'which', title: 'path' }, { field: 'mean', format: '.3f' }, { field: 'max', title: 'largest', format: '.3f' }] } },
      { mark: { type: 'rule', strokeWidth: 1.2, color: text, opacity: 0.6 }, encoding: { x: { field: 'mean', type: 'quantitative' }, x2: { field: 'max' }, y, yOffset } },
    ],
  };
}

/** Mean position errors per method: of runs and of studies' rows. */
export function errorEntries(data) {
  const entries = [];
  const add = (mission, method, label, ate) => isNumber(ate) && entries.push({ mission: String(mission), method: String(method), label, ate });
  const odometry = new Set();
  const addOdometry = (mission, label, ate) => {
    // The same odometry in every run of a mission: one entry, unless noise was added.
    const key = `${mission}\n${isNumber(ate) ? ate.toPrecision(9) : ''}`;
    if (odometry.has(key)) return;
    odometry.add(key);
    add(mission, 'odometry', label, ate);
  };
  for (const run of data.runs) {
    add(run.problem, run.variant, run.label, run.summary.ate_m?.optimized);
    addOdometry(run.problem, run.label, run.summary.ate_m?.odometry);
  }
  // Studies share the charts: what tells their rows apart is looked for in all of them.
  const variant = variantOf({ rows: data.studies.flatMap((study) => study.rows) });
  const noise = (study) => noiseOf(flatOptions(study.result?.options));
  const noises = new Set(data.studies.map(noise));
  for (const study of data.studies) {
    for (const row of study.rows) {
      const world = noises.size > 1 ? `${worldOf(study, row)}, ${noise(study)}` : worldOf(study, row);
      const label = `${study.label}: ${row.mission ?? ''}, seed ${row.seed ?? '–'}`;
      add(world, variant(row), label, row.ate_m);
      addOdometry(world, label, row.odometry_ate_m);
    }
  }
  return entries;
}

/** Medians of a study's repetitions over the share of mission time, with a band of the quartiles. */
function studyOverTime(study, world, figure, yTitle, wide) {
  const variant = variantOf(study);
  const values = [];
  for (const series of study.curves.filter((one) => worldOf(study, one) === world)) {
    series.share.forEach((t, i) => {
      const [lower, y, upper] = ['lower', 'median', 'upper'].map((name) => series[figure][name][i]);
      if (isNumber(y)) values.push({ series: variant(series), method: series.method, t: 100 * t, y, lower, upper });
    });
  }
  if (values.length === 0) return null;
  const log = wide ? logAxis(values.flatMap((v) => [v.lower, v.upper])) : null;
  const domain = [...new Set(values.map((v) => v.series))].sort(methodOrder);
  const range = domain.map((name, i) => methodColour(values.find((v) => v.series === name).method, i));
  const x = { field: 't', type: 'quantitative', title: 'mission time (%)', axis: { grid: false }, scale: { nice: false } };
  const color = { field: 'series', type: 'nominal', scale: { domain, range }, sort: null, legend: { symbolOpacity: 1 } };
  const scale = log ?? {};
  const over = Math.max(...values.map((v) => v.t)) > 101;
  return {
    data: { values: log ? values.filter((v) => v.lower > 0) : values },
    layer: [
      ...(over ? [{ data: { values: [{ t: 100 }] }, mark: { type: 'rule', strokeDash: [3, 3] }, encoding: { x: { field: 't', type: 'quantitative' } } }] : []),
      { mark: { type: 'area', opacity: 0.14, clip: true }, encoding: { x, y: { field: 'lower', type: 'quantitative', title: yTitle, ...scale }, y2: { field: 'upper' }, color } },
      { mark: { type: 'line', clip: true }, encoding: { x, y: { field: 'y', type: 'quantitative', title: yTitle, ...scale }, color, tooltip: [{ field: 'series', title: 'method' }, { field: 't', title: 'time (%)', format: '.0f' }, { field: 'y', title: yTitle, format: ',.3~r' }] } },
    ],
  };
}

/** The charts that the data allow: [{id, title, caption, spec}]. */
function plan(data, run) {
  const { kept, outlier } = ink();
  const colours = { verified: methodColour('obs'), 'kept by GNC': kept, true: methodColour('gi'), estimate: methodColour('obs'), 'odometry alone': methodColour('odometry') };
  const withRows = data.runs.filter((one) => one.rows.length > 1);
  // Runs of many missions are told apart in the tables; over time a screen holds a dozen.
  const shown = withRows.length <= 12 ? withRows : withRows.filter((one) => one.problem === run?.problem).slice(0, 12);
  const charts = [];
  const push = (id, title, caption, spec) => spec && charts.push({ id, title, caption, spec });
  push('ratio', 'Inliers per queued candidate', `Closures that robust optimisation (GNC) keeps${shown.some((one) => isNumber(one.summary.closures?.true_inliers)) ? ', and true ones (within 5 cm and 0.05 rad)' : ''}, as a share of all candidates queued so far: higher means that the better candidates are computed.`,
    overTime(shown, ['gnc_inliers', 'true_inliers'], (row, c) => (row.queued > 0 && isNumber(row[c]) ? (100 * row[c]) / row.queued : null), 'share of queued (%)', { colours, wide: true }));
  push('error', 'Error over time', 'Mean position error of all nodes that have arrived, in the common frame without alignment.',
    overTime(shown, ['ate_m', ...(shown.length > 1 ? [] : ['odometry_ate_m'])], (row, c) => row[c], 'mean position error (m)', { kinds: { ate_m: 'estimate', odometry_ate_m: 'odometry alone' }, colours }));
  push('closures', 'Closures over time', 'Verified by registration, and how many of them robust optimisation keeps.',
    overTime(shown, ['verified', 'gnc_inliers', ...(shown.length > 1 ? [] : ['true_inliers'])], (row, c) => row[c], 'closures', { colours, format: ',d' }));
  if (run) push('robots', `Error by robot: ${run.name}`, null, robots(run));
  const entries = errorEntries(data);
  for (const mission of [...new Set(entries.map((entry) => entry.mission))]) {
    const own = entries.filter((entry) => entry.mission === mission);
    if (own.length < 3) continue;
    push(`boxes-${charts.filter((c) => c.id.startsWith('boxes')).length}`, `Error by method: ${mission}`, 'Each point is a run; the box holds the middle half, the line is the median.', boxes(own, mission));
  }
  for (const study of data.studies) {
    for (const world of [...new Set(study.rows.map((row) => worldOf(study, row)))]) {
      const id = charts.filter((c) => c.id.startsWith('study')).length;
      push(`study-${id}`, `Error over time: ${world}`, 'Median of the runs’ mean position errors; the band holds the middle half.', studyOverTime(study, world, 'ate_m', 'mean position error (m)'));
      push(`study-${id + 1}`, `Inliers per queued candidate: ${world}`, 'Median share that robust optimisation keeps; the band holds the middle half.', studyOverTime(study, world, 'gnc_share', 'share of queued (%)', true));
    }
  }
  return charts;
}

/** Draws the charts into `container`; resolves when all are drawn. `state` gets their marks. */
export async function drawCharts(container, data, run, state) {
  const charts = plan(data, run);
  container.replaceChildren();
  for (const id of Object.keys(state)) delete state[id];
  const cards = charts.map(({ id, title, caption }) => {
    const target = h('div', { class: 'chart', id: `chart-${id}` });
    container.append(h('figure', { class: 'card' }, h('figcaption', {}, h('h3', {}, title), caption && h('p', {}, caption)), target));
    return target;
  });
  for (const [i, { id, title, spec }] of charts.entries()) {
    const { view } = await embed(cards[i], {
      $schema: 'https://vega.github.io/schema/vega-lite/v6.json', width: 'container', height: 230,
      autosize: { type: 'fit-x', contains: 'padding' }, description: title, ...spec, config: config(),
    }, { renderer: 'svg', actions: { export: true, source: false, compiled: false, editor: false }, tooltip: { theme: 'custom' }, downloadFileName: `loopwise-${id}` });
    state[id] = cards[i].querySelectorAll('svg path[d], svg rect').length;
    cards[i].view = view;
    await new Promise((next) => setTimeout(next));
  }
}
