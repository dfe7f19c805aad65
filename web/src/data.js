// SPDX-License-Identifier: BSD-3-Clause
// The page's data, as loopwise/evaluation/report.hpp describes them.
import { isNumber } from './dom.js';

function decode(text, Type) {
  if (text === null || text === undefined) return null;
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; ++i) bytes[i] = binary.charCodeAt(i);
  return new Type(bytes.buffer);
}

const layer = (json) => json && { total: json.total, drawn: json.drawn, ends: decode(json.ends, Uint32Array) };

function decodeScene(json) {
  if (!json) return null;
  const { nodes, points } = json;
  return {
    robots: json.robots,
    nodes: {
      count: nodes.total,
      stride: nodes.stride,
      begin: nodes.begin,
      key: nodes.key,
      optimized: decode(nodes.optimized, Float32Array),
      odometry: decode(nodes.odometry, Float32Array),
      truth: decode(nodes.truth, Float32Array),
      reference: decode(nodes.reference, Float32Array),
      time_s: decode(nodes.time_s, Float32Array),
      observability: decode(nodes.observability, Float32Array),
    },
    points: points && {
      total: points.total,
      drawn: points.drawn,
      low: points.low,
      step: points.step,
      position: decode(points.position, Uint16Array),
      robot: decode(points.robot, Uint8Array),
      observability: decode(points.observability, Uint8Array),
    },
    candidates: Object.fromEntries(Object.entries(json.candidates).map(([name, one]) => [name, layer(one)])),
    beacons: json.beacons,
    review: json.review && { ...json.review, scans: Object.fromEntries(Object.entries(json.review.scans).map(([node, scan]) => [node, { ...scan, points: decode(scan.points, Uint16Array) }])) },
    radio: json.radio && { ...json.radio, ...layer(json.radio) },
  };
}

/** Rows of a history: [{mission_time_s, queued, ...}]. */
function historyRows(json) {
  if (!json) return [];
  const names = Object.keys(json.columns);
  const length = names.length ? json.columns[names[0]].length : 0;
  return Array.from({ length }, (_, i) => Object.fromEntries(names.map((name) => [name, json.columns[name][i]])));
}

/** {"engine.seed": "1", ...} */
export function flatOptions(value, path = '') {
  if (value === null || value === undefined) return {};
  if (typeof value !== 'object' || Array.isArray(value)) return { [path]: Array.isArray(value) ? value.join(', ') : String(value) };
  return Object.assign({}, ...Object.entries(value).map(([name, inner]) => flatOptions(inner, path ? `${path}.${name}` : name)));
}

const isNoise = (path) => path.includes('odometry_noise_');
/** What odometry was made worse by: as another mission, not as another method. */
export function noiseOf(options) {
  const sigmas = Object.entries(options).filter(([path, value]) => isNoise(path) && Number(value) > 0).map(([path, value]) => `${value} ${path.includes('_rad_') ? 'rad/m' : 'm/m'}`);
  return sigmas.length > 0 ? `odometry noise ${sigmas.sort().join(', ')}` : 'no odometry noise';
}

/** `problem`: the mission, and the noise of its odometry where runs or studies differ in it. */
function nameProblems(data) {
  for (const run of data.runs) {
    const noises = new Set(data.runs.filter((one) => one.mission === run.mission).map((one) => noiseOf(one.options)));
    run.problem = noises.size > 1 ? `${run.mission}, ${noiseOf(run.options)}` : run.mission;
  }
}

/** `variant`: the method, and the options in which runs of it differ beside their seeds. */
function nameVariants(data) {
  for (const run of data.runs) {
    const own = data.runs.filter((one) => one.problem === run.problem && one.method === run.method);
    // An option that a run of another version lacks tells nothing.
    const differing = Object.keys(run.options).filter((path) => !isNoise(path) && !/(^|\.)(seed|method)$/.test(path) && own.every((one) => path in one.options) && own.some((one) => one.options[path] !== run.options[path]));
    const words = differing.map((path) => `${path.split('.').pop().replace(/_/g, ' ')} ${run.options[path] || '–'}`);
    run.variant = words.length === 0 ? run.method : words.length <= 3 ? [run.method, ...words].join(', ') : `${run.method} (${run.label})`;
  }
}

export function readData(text) {
  const data = JSON.parse(text);
  if (data.format !== 'loopwise-report') throw new Error('not the data of a report');
  data.runs.forEach((run) => {
    run.mission = String(run.summary.mission ?? '');
    run.method = String(run.summary.method ?? '');
    run.options = flatOptions(run.summary.options);
  });
  nameProblems(data);
  nameVariants(data);
  const several = new Set(data.runs.map((run) => run.problem)).size > 1;
  const alike = (run) => data.runs.filter((one) => one.problem === run.problem && one.variant === run.variant);
  data.runs.forEach((run, i) => {
    run.index = i;
    run.rows = historyRows(run.history);
    // Without ground truth the history counts none.
    if (run.summary.closures?.true_inliers === null) run.rows.forEach((row) => (row.true_inliers = null));
    // Runs of one method and mission are repetitions if their seeds differ; else their folders tell them apart.
    const group = alike(run);
    const repeated = group.length > 1 && new Set(group.map((one) => one.summary.seed)).size === group.length;
    const prefix = several ? `${run.problem} · ` : '';
    run.name = prefix + (group.length === 1 ? run.variant : repeated ? `${run.variant}, seed ${run.summary.seed}` : `${run.variant} (${run.label})`);
    run.series = repeated ? prefix + run.variant : run.name;
    const end = run.summary.mission_end_s;
    run.end_s = isNumber(end) ? end : null;
    let scene;
    Object.defineProperty(run, 'decoded', { get: () => (scene ??= decodeScene(run.scene)) });
  });
  return data;
}
