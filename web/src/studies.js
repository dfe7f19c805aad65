// SPDX-License-Identifier: BSD-3-Clause
// What the rows of studies say together: medians by world and method.
import { at, count, fixed, h, isNumber, table } from './dom.js';

/** Linear between order statistics, as most tools. */
export function quantile(values, share) {
  const sorted = values.filter(isNumber).sort((a, b) => a - b);
  if (sorted.length === 0) return null;
  const place = share * (sorted.length - 1);
  const low = Math.floor(place);
  return sorted[low] + (place - low) * ((sorted[low + 1] ?? sorted[low]) - sorted[low]);
}
export const median = (values) => quantile(values, 0.5);

export const worldOf = (study, row) => String(row.world ?? row.mission ?? study.label);

/** What tells runs of one method apart, with what rows of earlier versions lack. */
const kVariants = { registration_time_s: undefined, refused_time_share: 1, workers: undefined, thin: undefined, after_mission: undefined, truth_alignment: 'none' };

/** The method, and what else differs between a study's runs: "full, workers 50". */
export function variantOf(study) {
  const value = (row, name) => row[name] ?? kVariants[name];
  const differing = Object.keys(kVariants).filter((name) => new Set(study.rows.map((row) => value(row, name))).size > 1);
  return (row) => [String(row.method), ...differing.map((name) => `${name.replace(/_s$/, '').replace(/_/g, ' ')} ${value(row, name)}`)].join(', ');
}

const share = (part, whole) => (row) => (row[whole] > 0 && isNumber(row[part]) ? (100 * row[part]) / row[whole] : null);
const kFigures = [
  ['verified, % of queued', share('verified', 'queued'), 3], ['GNC inliers, % of queued', share('gnc_inliers', 'queued'), 3],
  ['true inliers, % of queued', share('true_inliers', 'queued'), 3], ['verified, % of computed', share('verified', 'computed'), 1],
  ['true inliers, % of computed', share('true_inliers', 'computed'), 1], ['mean position error, m', (row) => row.ate_m, 3], ['the same aligned, m', (row) => row.ate_se3_m, 3],
];

const minus = (text) => text.replace(/-/g, '−');
const distinct = (values) => [...new Set(values)];

const isOfRobots = (study) => study.kind === 'rssi';

/** Runs of a study. Where its rows are of robots, those of odometry alone belong to other runs. */
export function runCount(study) {
  if (!isOfRobots(study)) return study.rows.length;
  return distinct(study.rows.filter((row) => row.method !== 'odom').map((row) => JSON.stringify([row.mission, row.mission_seed, row.method, row.seed]))).length;
}

/** The paper's Table II: for each world, the errors of each robot by method. */
function robotTables(study) {
  return distinct(study.rows.map((row) => worldOf(study, row))).map((world) => {
    const rows = study.rows.filter((row) => worldOf(study, row) === world);
    const methods = distinct(rows.map((row) => String(row.method)));
    const line = (robot, mean, digits, most) => methods.map((method) => {
      const own = rows.filter((row) => String(row.robot) === robot && String(row.method) === method);
      return `${fixed(median(own.map((row) => row[mean])), digits)} (${fixed(median(own.map((row) => row[most])), 2)})`;
    });
    const body = distinct(rows.map((row) => String(row.robot))).flatMap((robot) => [
      [robot, 'transl., % (largest, m)', ...line(robot, 'translation_percent', 3, 'max_m')],
      ['', 'rot., °/m (largest, °)', ...line(robot, 'rotation_deg_per_m', 4, 'max_deg')],
    ]);
    const missions = distinct(rows.map((row) => row.mission)).length;
    return h('div', { class: 'card study' }, table(`${world}: errors of each robot, medians over ${missions} mission${missions === 1 ? '' : 's'}`, ['', '', ...methods], body, { class: 'left2' }));
  });
}

/** The paper's tables of one study: one for each world. */
export function studyTables(study) {
  if (isOfRobots(study)) return robotTables(study);
  const variant = variantOf(study);
  return distinct(study.rows.map((row) => worldOf(study, row))).map((world) => {
    const rows = study.rows.filter((row) => worldOf(study, row) === world);
    const variants = distinct(rows.map(variant));
    const missions = new Set(rows.map((row) => row.mission)).size;
    const odometry = median(distinct(rows.map((row) => row.odometry_ate_m)));
    const best = Math.min(...variants.map((v) => median(rows.filter((row) => variant(row) === v).map((row) => row.ate_m))).filter(isNumber));
    const known = kFigures.filter(([, value]) => rows.some((row) => isNumber(value(row))));
    const body = known.map(([name, value, digits]) => [name, ...variants.map((v) => {
      const values = rows.filter((row) => variant(row) === v).map(value).filter(isNumber);
      if (values.length === 0) return '–';
      const middle = fixed(median(values), digits);
      const strong = name.startsWith('mean') && median(values) === best ? h('strong', {}, middle) : middle;
      return values.length < 2 ? strong : h('span', { title: `${values.length} runs` }, strong, h('span', { class: 'detail' }, ` ${fixed(quantile(values, 0.25), digits)}–${fixed(quantile(values, 0.75), digits)}`));
    })]);
    return h('div', { class: 'card study' }, table(`${world}: ${count(rows.length)} runs of ${missions} mission${missions === 1 ? '' : 's'}, medians and quartiles${isNumber(odometry) ? `; odometry alone ${fixed(odometry, 3)} m` : ''}`, ['', ...variants], body));
  });
}

/** How much lower a method's median error is than another's, %, mean over the worlds; null where one lacks. */
function reduction(study, method, other) {
  const worlds = distinct(study.rows.map((row) => worldOf(study, row)));
  const reductions = worlds.map((world) => {
    const rows = study.rows.filter((row) => worldOf(study, row) === world);
    const own = median(rows.filter((row) => row.method === method).map((row) => row.ate_m));
    const against = other === 'odometry' ? median(distinct(rows.map((row) => row.odometry_ate_m))) : median(rows.filter((row) => row.method === other).map((row) => row.ate_m));
    return isNumber(own) && against > 0 ? 100 * (1 - own / against) : null;
  });
  return reductions.every(isNumber) && reductions.length > 0 ? reductions.reduce((a, b) => a + b, 0) / reductions.length : null;
}

/** Key figures of a report that has studies alone: [label, value, detail]. */
export function studyFigures(study) {
  const methods = distinct(study.rows.map((row) => row.method));
  const method = methods.includes('full') ? 'full' : methods.at(-1);
  const worlds = distinct(study.rows.map((row) => worldOf(study, row)));
  const missions = distinct(study.rows.map((row) => row.mission)).length;
  const change = (value) => `${value >= 0 ? '−' : '+'}${Math.abs(value).toFixed(0)} %`;
  return [
    ['Runs', count(runCount(study)), `${missions} mission${missions === 1 ? '' : 's'} of ${worlds.length} world${worlds.length === 1 ? '' : 's'}, ${methods.length} methods`],
    ...['odometry', 'baseline'].filter((other) => other !== method).map((other) => [other, reduction(study, method, other)])
      .filter(([, value]) => isNumber(value)).map(([other, value]) => [`Error of ${method} against ${other}`, change(value), 'median error, mean over the worlds']),
  ];
}

/** How a study was made. */
export function studyProvenance(study) {
  const result = study.result ?? {};
  const hashes = distinct(study.rows.map((row) => `${worldOf(study, row)}: ${row.parameters_sha256 ?? 'not known'}`));
  const plain = Object.entries(result).filter(([, value]) => ['string', 'number', 'boolean'].includes(typeof value));
  return h('div', { class: 'card' }, table(study.label, ['', ''], [
    ...plain.map(([name, value]) => [name.replace(/_/g, ' '), String(value)]),
    ...(Array.isArray(result.seeds) ? [['seeds', result.seeds.join(', ')]] : []), ['parameters of the worlds', hashes.join(' ')],
  ], { class: 'left' }));
}

/** Paired comparisons over all missions: by method and other from `loopwise study ablation`, a list from `budget`. */
export function pairedTable(study) {
  const pooled = at(study, 'result', 'pooled');
  if (!pooled || typeof pooled !== 'object') return null;
  const interval = (value) => {
    const [low, high] = Array.isArray(value) ? value : [at(value, 'low'), at(value, 'high')];
    return isNumber(low) && isNumber(high) ? ` (${fixed(low, 3)} to ${fixed(high, 3)})` : '';
  };
  const comparisons = Array.isArray(pooled)
    ? pooled.map((c) => [String(at(c, 'run')), String(at(c, 'against')), c])
    : Object.entries(pooled).flatMap(([method, others]) => Object.entries(others ?? {}).map(([other, c]) => [method, other, c]));
  const rows = comparisons.map(([method, other, c]) => [
    method, other, isNumber(at(c, 'better')) ? `${c.better} of ${c.count ?? c.missions ?? '–'}` : '–',
    minus(fixed(at(c, 'mean_difference_m'), 3) + interval(at(c, 'difference_interval_95_m'))), fixed(at(c, 'ratio'), 3) + interval(at(c, 'ratio_interval_95')),
  ]);
  if (rows.length === 0) return null;
  return h('div', { class: 'card' }, table('All missions, paired: mean position error (95 % intervals)', ['method', 'against', 'lower in', 'mean difference (m)', 'ratio'], rows, { class: 'left2' }));
}
