// SPDX-License-Identifier: BSD-3-Clause
// Everything as figures.
import { runCount, studyProvenance } from './studies.js';
import { at, count, duration, fixed, h, isNumber, metres, percent, table } from './dom.js';

const words = (name) => String(name).replace(/_/g, ' ');

/** A row's figure with a bar of its share behind it. */
const barred = (value, whole) => h('span', { class: 'barred', style: `--share: ${isNumber(value) && whole > 0 ? ((100 * value) / whole).toFixed(1) : 0}%` }, count(value));

function accounting(run) {
  const c = run.summary.candidates ?? {};
  const k = run.summary.closures ?? {};
  const rows = [
    ['generated', c.generated], ['pruned by the method', c.pruned], ['expired', c.expired], ['still pending', c.pending],
    ['computed', c.computed], ['verified', k.verified], ['kept by GNC', k.gnc_inliers], ...(isNumber(k.true_inliers) ? [['true (5 cm, 0.05 rad)', k.true_inliers]] : []),
  ].map(([name, value]) => [name, barred(value, c.generated), percent(value, c.queued), percent(value, c.computed)]);
  for (const row of rows.slice(0, 4)) row[3] = '';
  return table('Candidates', ['', 'number', '% of queued', '% of computed'], rows);
}

function reasons(run) {
  const all = Object.entries(run.summary.reasons ?? {}).sort((a, b) => b[1] - a[1]);
  const other = [...Object.entries(run.summary.pruned_reasons ?? {}).map(([k, v]) => [`pruned: ${k}`, v]), ...Object.entries(run.summary.expired_reasons ?? {}).map(([k, v]) => [`expired: ${k}`, v])];
  const total = all.reduce((sum, [, value]) => sum + value, 0);
  if (all.length + other.length === 0) return null;
  return table('Why candidates were rejected', ['', 'number', 'share'], [...all, ...other].map(([name, value]) => [words(name), barred(value, total), name.includes(':') ? '' : percent(value, total)]));
}

function robots(run) {
  const all = Object.entries(run.summary.robots ?? {});
  if (all.length === 0 || !run.summary.ate_m) return null;
  const of = (robot, which) => [metres(at(robot, which, 'ate_m', 'mean')), metres(at(robot, which, 'ate_m', 'max')), fixed(at(robot, which, 'translation_percent'), 2), fixed(at(robot, which, 'rotation_deg_per_m'), 3)];
  const rows = all.flatMap(([name, robot]) => [
    [name, String(robot.poses ?? '–'), fixed(robot.path_length_m, 0), 'odometry', ...of(robot, 'odometry')],
    ['', '', '', 'optimised', ...of(robot, 'optimized')],
  ]);
  return table(`Errors by robot${aligned(run)}`, ['', 'nodes', 'path (m)', '', 'mean', 'largest', 'transl. %', 'rot. °/m'], rows);
}

const degrees = (v) => (isNumber(v) ? `${((v * 180) / Math.PI).toFixed(3)}°` : '–');
const aligned = (run) => (at(run, 'summary', 'truth', 'alignment') === 'se3' ? ' after alignment: the truth is in another frame' : '');

/** How well closures and poses agree with each other: known without a truth. */
function residuals(run) {
  const s = run.summary;
  if (!s.residuals) return null;
  const row = (name, field, which, unit) => [name, unit(at(s, 'residuals', 'odometry', field, which)), unit(at(s, 'residuals', 'optimized', field, which))];
  return table(`Residuals of ${count(s.residuals.closures)} kept closures`, ['', 'odometry', 'optimised'], [
    row('median', 'translation_m', 'median', metres), row('largest', 'translation_m', 'max', metres), row('median, attitude', 'rotation_rad', 'median', degrees),
  ]);
}

/** The map at revisits that it was not made of: known without a truth, after `loopwise evaluate --map`. */
function mapQuality(run) {
  const q = run.summary.map_quality;
  if (!q) return null;
  const share = (v) => (isNumber(v) ? `${(100 * v).toFixed(1)} %` : '–');
  const displacement = (name, field) => [name, metres(at(q, 'displacement_m', 'recording', field)), metres(at(q, 'displacement_m', 'estimate', field)), ''];
  const three = (name, field, unit) => [name, unit(at(q, field, 'recording')), unit(at(q, field, 'estimate')), unit(at(q, field, 'registered'))];
  const [low, high] = q.difference_interval_95 ?? [];
  const notes = [
    q.not_meaningful && h('strong', {}, `Not meaningful: ${q.not_meaningful}. `),
    q.revisits > 0 && `${count(q.revisits)} revisits on ${isNumber(q.coverage) ? (100 * q.coverage).toFixed(0) : '–'} % of the path. `,
    isNumber(low) && `The estimate’s mean displacement minus the recording’s is ${fixed(q.difference_m, 3)} m, 95 % interval ${fixed(low, 3)} to ${fixed(high, 3)} m. `,
  ];
  const rows = q.revisits > 0 ? [
    displacement('displacement, mean', 'mean'), displacement('displacement, median', 'median'), displacement('displacement, worst tenth above', 'worst_tenth'),
    three('thickness of surfaces', 'thickness_m', metres), three('points on the other scan’s surfaces', 'share_on_surfaces', share),
  ] : [];
  return h('div', { id: 'map-quality' }, table('Map at revisits that the estimate was not made of', ['', 'before', 'after', 'at best'], rows), h('p', {}, notes));
}

function reference(run) {
  const s = run.summary;
  if (!s.reference) return null;
  const row = (name, field, unit) => [name, unit(at(s, 'reference', field, 'odometry')), unit(at(s, 'reference', field, 'optimized'))];
  return table('Difference from the session’s own optimised poses, which are another program’s result', ['', 'odometry', 'optimised'], [
    row('mean position', 'difference_m', metres), row('mean attitude', 'difference_rad', degrees),
  ]);
}

function errors(run) {
  const s = run.summary;
  if (!s.ate_m) return null;
  const row = (name, field, unit = metres) => [name, unit(at(s, field, 'odometry')), unit(at(s, field, 'optimized'))];
  return table(`Errors of all positions${aligned(run)}`, ['', 'odometry', 'optimised'], [
    row('mean, common frame (the paper’s ATE)', 'ate_m'), row('root mean square', 'ate_rmse_m'), row('mean, aligned', 'ate_se3_m'), row('mean attitude', 'ate_rad', degrees),
    ['per step, mean', metres(at(s, 'rpe', 'odometry', 'translation_m', 'mean')), metres(at(s, 'rpe', 'optimized', 'translation_m', 'mean'))],
  ]);
}

/** Runs side by side; the best error of a mission stands out. */
export function comparison(data, select) {
  if (data.runs.length < 2) return null;
  const missions = new Set(data.runs.map((run) => run.problem)).size > 1;
  const judged = data.runs.some((run) => isNumber(at(run, 'summary', 'ate_m', 'optimized')));
  const mapped = data.runs.some((run) => isNumber(at(run, 'summary', 'map_quality', 'displacement_m', 'estimate', 'mean')));
  const best = (run) => Math.min(...data.runs.filter((one) => one.problem === run.problem).map((one) => at(one, 'summary', 'ate_m', 'optimized')).filter(isNumber));
  const rows = data.runs.map((run) => {
    const { candidates: c = {}, closures: k = {} } = run.summary;
    const ate = at(run, 'summary', 'ate_m', 'optimized');
    return {
      attributes: { 'data-run': run.index },
      cells: [
        h('button', { class: 'link', type: 'button', onclick: () => select(run.index) }, run.label), run.variant, ...(missions ? [run.problem] : []), String(run.summary.seed ?? '–'),
        count(c.queued), count(c.computed), percent(k.verified, c.queued), percent(k.gnc_inliers, c.queued), metres(at(run, 'summary', 'residuals', 'optimized', 'translation_m', 'median')),
        ...(mapped ? [metres(at(run, 'summary', 'map_quality', 'displacement_m', 'estimate', 'mean'))] : []),
        ...(judged ? [percent(k.true_inliers, c.queued), metres(at(run, 'summary', 'ate_m', 'odometry')), isNumber(ate) && ate === best(run) ? h('strong', {}, metres(ate)) : metres(ate), metres(at(run, 'summary', 'ate_se3_m', 'optimized'))] : []),
      ],
    };
  });
  return table(`Runs. Shares are of queued candidates, residuals medians of kept closures${mapped ? ', displacements means at revisits' : ''}${judged ? ', errors means over all positions' : ''}`, ['run', 'method', ...(missions ? ['mission'] : []), 'seed', 'queued', 'computed', 'verified', 'GNC inliers', 'residual', ...(mapped ? ['displacement'] : []), ...(judged ? ['true inliers', 'odometry', 'error', 'aligned'] : [])], rows, { class: 'left2' });
}

export function allRuns(study) {
  const cells = (row) => study.columns.map((name) => {
    const value = row[name];
    if (!isNumber(value)) return value === null ? '–' : String(value).length > 40 ? h('span', { title: String(value) }, `${String(value).slice(0, 12)}…`) : String(value);
    return Number.isInteger(value) ? count(value) : fixed(value, Math.abs(value) < 10 ? 4 : 2);
  });
  return h('details', {}, h('summary', {}, `All ${study.rows.length} ${runCount(study) === study.rows.length ? 'runs' : 'rows'} of ${study.label}`), table(null, study.columns.map(words), study.rows.map(cells)));
}

export function runTables(run) {
  return [accounting(run), errors(run), residuals(run), mapQuality(run), reference(run), robots(run), reasons(run)].filter(Boolean).map((one) => h('div', { class: 'card' }, one));
}

const flat = (value, path = '') =>
  value !== null && typeof value === 'object' && !Array.isArray(value) ? Object.entries(value).flatMap(([name, inner]) => flat(inner, path ? `${path}.${name}` : name)) : [[path, Array.isArray(value) ? value.map((v) => (typeof v === 'object' ? JSON.stringify(v) : v)).join(', ') : String(value)]];

/** Where everything comes from. */
export function provenance(data, run) {
  const parts = [];
  const mission = run && data.missions.find((one) => one.name === run.mission);
  if (run) {
    const s = run.summary;
    const facts = [
      ['report by', data.generator], ['run', run.label], ['mission', run.mission], ['method', run.method], ['seed', String(s.seed ?? '–')],
      ...Object.entries(s).filter(([name, value]) => typeof value === 'string' && !['mission', 'method'].includes(name)).map(([name, value]) => [words(name), value]),
      ['mission time', duration(s.mission_time_s)], ['computing time here', duration(at(s, 'seconds', 'total'))],
      ['batches, optimisations', `${count(s.batches)}, ${count(s.optimizations)}`],
    ];
    parts.push(table('This run', ['', ''], facts, { class: 'left' }));
  }
  if (mission) parts.push(table('Its mission', ['', ''], flat({ ...mission, communication_gaps: mission.communication_gaps.map((g) => `${g.robot} ${duration(g.begin_s)} to ${duration(g.end_s)}`) }), { class: 'left' }));
  parts.push(...data.studies.map(studyProvenance));
  const options = run?.summary.options;
  return [
    h('div', { class: 'cards' }, parts.map((part) => (part.classList.contains('card') ? part : h('div', { class: 'card' }, part)))),
    data.studies.map((study) => study.result?.options && h('details', {}, h('summary', {}, `All options of ${study.label}`), table(null, ['option', 'value'], flat(study.result.options), { class: 'left mono' }))),
    options && h('details', {}, h('summary', {}, 'All options of this run'), table(null, ['option', 'value'], flat(options), { class: 'left mono' })),
    run && run.summary.problems?.length > 0 && h('details', {}, h('summary', {}, `Problems found in its files (${run.summary.problems.length})`), h('ul', {}, run.summary.problems.map((text) => h('li', {}, String(text))))),
    run && run.notes.length > 0 && h('details', { open: true, id: 'notes' }, h('summary', {}, 'Not shown'), h('ul', {}, run.notes.map((text) => h('li', {}, text)))),
    h('details', {}, h('summary', {}, 'Licences of what this page contains'), h('pre', {}, document.getElementById('licences')?.textContent ?? '')),
  ];
}
