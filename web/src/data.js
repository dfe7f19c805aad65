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

export function readData(text) {
  const data = JSON.parse(text);
  if (data.format !== 'loopwise-report') throw new Error('not the data of a report');
  const several = new Set(data.runs.map((run) => run.summary.mission)).size > 1;
  const alike = (run) => data.runs.filter((one) => one.summary.mission === run.summary.mission && one.summary.method === run.summary.method);
  data.runs.forEach((run, i) => {
    run.index = i;
    run.rows = historyRows(run.history);
    // Without ground truth the history counts none.
    if (run.summary.closures?.true_inliers === null) run.rows.forEach((row) => (row.true_inliers = null));
    run.mission = String(run.summary.mission ?? '');
    run.method = String(run.summary.method ?? '');
    // Runs of one method and mission are repetitions if their seeds differ; else their folders tell them apart.
    const group = alike(run);
    const repeated = group.length > 1 && new Set(group.map((one) => one.summary.seed)).size === group.length;
    const prefix = several ? `${run.mission} · ` : '';
    run.name = prefix + (group.length === 1 ? run.method : repeated ? `${run.method}, seed ${run.summary.seed}` : `${run.method} (${run.label})`);
    run.series = repeated ? prefix + run.method : run.name;
    const end = run.summary.mission_end_s;
    run.end_s = isNumber(end) ? end : null;
    let scene;
    Object.defineProperty(run, 'decoded', { get: () => (scene ??= decodeScene(run.scene)) });
  });
  return data;
}
