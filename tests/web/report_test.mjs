// SPDX-License-Identifier: BSD-3-Clause
// Makes reports of the sample mission and inspects them in Chromium:
//   node report_test.mjs LOOPWISE SAMPLE_MISSION FOLDER [CHROMIUM]
// Prints "SKIPPED: reason" if a program that it needs is absent. Pictures stay in FOLDER.
import assert from 'node:assert/strict';
import { spawnSync } from 'node:child_process';
import { cpSync, existsSync, mkdirSync, readFileSync, renameSync, rmSync, statSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';
import { Browser } from './browser.mjs';

const [program, sample, folder, given] = process.argv.slice(2);
const skip = (why) => {
  console.log(`SKIPPED: ${why}`);
  process.exit(0);
};
const chromium = given ?? ['chromium', 'chromium-browser', 'google-chrome'].find((name) => spawnSync(name, ['--version']).status === 0);
if (!chromium) skip('no chromium');

const loopwise = (...words) => {
  const run = spawnSync(program, words, { encoding: 'utf8' });
  if (/this build cannot write reports/.test(run.stderr)) skip('this build has no page for reports: npm was absent or failed');
  assert.equal(run.status, 0, `loopwise ${words.join(' ')}\n${run.stderr}`);
  return run.stdout;
};

rmSync(folder, { recursive: true, force: true });
mkdirSync(folder, { recursive: true });
const inFolder = (name) => join(folder, name);

// A mission with names that contain markup.
const kMission = '</script><script>window.hacked = 1</script><b>';
const kRobot = '<img src=x onerror="window.hacked=2">&amp;';
cpSync(sample, inFolder('mission'), { recursive: true });
const about = JSON.parse(readFileSync(join(sample, 'mission.json'), 'utf8'));
const [kOldRobot] = about.robots.map((robot) => robot.name);
about.name = kMission;
const named = JSON.stringify(about).split(JSON.stringify(kOldRobot)).join(JSON.stringify(kRobot));
writeFileSync(inFolder('mission/mission.json'), named);
const beacons = readFileSync(join(sample, 'beacons.csv'), 'utf8');
writeFileSync(inFolder('mission/beacons.csv'), beacons.split(kOldRobot).join(`"${kRobot.replaceAll('"', '""')}"`));

for (const method of ['baseline', 'obs', 'full']) {
  loopwise('replay', inFolder('mission'), '-o', inFolder(method), '--method', method, '--max-registrations', '150', '--quiet');
}
const runs = ['obs', 'baseline', 'full'].map(inFolder);
loopwise('report', ...runs, '-o', inFolder('all.html'), '--mission', inFolder('mission'), '--quiet');
loopwise('report', inFolder('obs'), '-o', inFolder('alone.html'), '--quiet');
for (const file of ['map.pcd', 'journal.jsonl', 'history.csv', 'closures.csv']) rmSync(join(inFolder('full'), file), { force: true });
rmSync(join(inFolder('full'), 'trajectories'), { recursive: true });
loopwise('report', inFolder('full'), '-o', inFolder('bare.html'), '--quiet');

// Without a truth.
cpSync(sample, inFolder('untrue'), { recursive: true });
rmSync(inFolder('untrue/ground_truth.g2o'));
loopwise('replay', inFolder('untrue'), '-o', inFolder('untrue_run'), '--max-registrations', '40', '--quiet');
loopwise('report', inFolder('untrue_run'), '-o', inFolder('untrue.html'), '--mission', inFolder('untrue'), '--quiet');

// With the poses of another program as a reference.
cpSync(sample, inFolder('referred'), { recursive: true });
renameSync(inFolder('referred/ground_truth.g2o'), inFolder('referred/reference.g2o'));
loopwise('replay', inFolder('referred'), '-o', inFolder('referred_run'), '--max-registrations', '40', '--quiet');
loopwise('report', inFolder('referred_run'), '-o', inFolder('referred.html'), '--mission', inFolder('referred'), '--quiet');
// With the truth.
loopwise('report', inFolder('referred_run'), '-o', inFolder('judged.html'), '--mission', inFolder('referred'), '--truth', join(sample, 'ground_truth.g2o'), '--quiet');

// Maps judged without a truth, as evaluate --map keeps them: of one run, and too few revisits for another.
const judgedMap = (name, quality) => {
  const file = join(inFolder(name), 'summary.json');
  writeFileSync(file, JSON.stringify({ ...JSON.parse(readFileSync(file, 'utf8')), map_quality: quality }));
};
const kQuality = {
  not_meaningful: null, pairs: 400, revisits: 210, stretches: 31, coverage: 0.62, displacement_m: { recording: { mean: 3.25, median: 2.5, worst_tenth: 7.5 }, estimate: { mean: 0.125, median: 0.0625, worst_tenth: 0.25 } },
  difference_m: -3.125, difference_interval_95: [-4.5, -1.75], thickness_m: { recording: 0.875, estimate: 0.042, registered: 0.021 }, share_on_surfaces: { recording: 0.03, estimate: 0.245, registered: 0.255 },
};
judgedMap('untrue_run', kQuality);
judgedMap('referred_run', { ...kQuality, not_meaningful: 'of 7 pairs <b>no</b> registration proves one', pairs: 7, revisits: 0, coverage: 0 });
for (const [name, mission] of [['untrue', 'untrue'], ['referred', 'referred']]) {
  loopwise('report', inFolder(`${name}_run`), '-o', inFolder(`${name}.html`), '--mission', inFolder(mission), '--quiet');
}
loopwise('report', inFolder('untrue_run'), inFolder('obs'), '-o', inFolder('maps.html'), '--quiet');

// Runs that differ in more than their seeds are no repetitions.
for (const [name, ...words] of [['n1', '--seed', '1'], ['n2', '--seed', '2', '--odometry-noise', '0.05', '0.01'], ['n3', '--seed', '3', '--odometry-noise', '0.05', '0.01'], ['n4', '--seed', '4', '--workers', '3', '--odometry-noise', '0.05', '0.01']]) {
  loopwise('replay', sample, '-o', inFolder(name), '--method', 'obs', '--max-registrations', '20', '--quiet', ...words);
}
loopwise('report', ...['n1', 'n2', 'n3', 'n4'].map(inFolder), '-o', inFolder('noise.html'), '--quiet');

// A study with names that contain markup, alone and together with a run.
mkdirSync(inFolder('study'));
const rows = ['world,mission,method,seed,workers,queued,computed,verified,gnc_inliers,true_inliers,ate_m,ate_se3_m,odometry_ate_m'];
for (const world of ['mine', '<b>urban</b>']) {
  for (const [method, error] of [['baseline', 4], ['obs', 2], ['full', 1]]) {
    for (const seed of [1, 2, 3, 4, 5]) rows.push([world, `${world}-${seed}`, method, seed, 10, 1000, 200, 100, 80, seed === 5 ? '' : 60, error + seed / 10, error, 4 + seed / 10].join(','));
  }
}
writeFileSync(inFolder('study/runs.csv'), `${rows.join('\n')}\n`);
writeFileSync(inFolder('study/ablation.json'), JSON.stringify({ pooled: { full: { baseline: { better: 10, count: 10, mean_difference_m: -3, difference_interval_95_m: [-3.1, -2.9] } } } }));
loopwise('report', inFolder('study'), '-o', inFolder('study.html'), '--quiet');

// Studies of computers and of robots, in one folder.
mkdirSync(inFolder('others'));
const kRun = 'world,mission,mission_seed,parameters_sha256,method,seed,registration_time_s,workers,thin,after_mission,mission_end_s,mission_time_s';
const curves = [`${kRun},time_s,computed,queued,verified,gnc_inliers,true_inliers,ate_m,odometry_ate_m`];
const robots = [`${kRun},robot,path_length_m,translation_percent,max_m,rotation_deg_per_m,max_deg`];
for (const seed of [1, 2, 3]) {
  for (const workers of [10, 50]) {
    for (const time of [0, 50, 100]) curves.push(`w,w-1,1,ab,full,${seed},1.3,${workers},1,0,100,100,${time},${time},100,${time},${time},${time / 2},${3 - seed / 10 - workers / 50},3`);
  }
  for (const [method, percent] of [['odom', 4], ['rssi', 2]]) robots.push(`w,w-1,1,ab,${method},${seed},1.3,10,1,0,100,100,<i>husky</i>,90,${percent + seed / 10},${percent},0.0125,1.5`);
}
writeFileSync(inFolder('others/curves.csv'), `${curves.join('\n')}\n`);
writeFileSync(inFolder('others/robots.csv'), `${robots.join('\n')}\n`);
writeFileSync(inFolder('others/budget.json'), JSON.stringify({ pooled: [{ run: 'full-w50', against: 'full-w10', better: 3, missions: 3, mean_difference_m: -0.8, difference_interval_95_m: [-0.9, -0.7], ratio: 0.5, ratio_interval_95: [0.4, 0.6] }] }));
loopwise('report', inFolder('others'), '-o', inFolder('others.html'), '--quiet');
loopwise('report', inFolder('obs'), inFolder('study'), '-o', inFolder('both.html'), '--quiet');

let browser = new Browser(chromium);
const open = async (name, options) => {
  const page = await browser.open(pathToFileURL(inFolder(name)).href, options);
  await page.until('window.loopwiseReport?.ready === true');
  return page;
};
const state = (page) => page.value('({...loopwiseReport, map: undefined})');
const clean = async (page, name) => {
  assert.deepEqual(page.complaints, [], `${name}: complaints`);
  assert.deepEqual((await state(page)).errors, [], `${name}: errors`);
  assert.deepEqual(page.requests, [pathToFileURL(inFolder(name)).href], `${name}: asked for more than itself`);
};
const text = (page, selector) => page.value(`document.querySelector('${selector}')?.textContent ?? ''`);
/** Labels of the vertical axis of a chart. */
const ticks = (page, id) => page.value(`[...document.querySelectorAll('#chart-${id} [aria-label^="Y-axis"] .role-axis-label text')].map((t) => t.textContent).filter(Boolean)`);
/** Pixels of the map that are not ground, and a sum that tells pictures apart. */
const pixels = (page) => page.value(`new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => {
  const from = document.querySelector('#map canvas');
  const canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = [from.width, from.height];
  const pen = canvas.getContext('2d');
  pen.drawImage(from, 0, 0);
  const data = pen.getImageData(0, 0, canvas.width, canvas.height).data;
  let drawn = 0, sum = 0;
  for (let i = 0; i < data.length; i += 4) {
    const off = Math.abs(data[i] - data[0]) + Math.abs(data[i + 1] - data[1]) + Math.abs(data[i + 2] - data[2]);
    if (off > 12) ++drawn;
    sum = (sum * 31 + data[i] + 3 * data[i + 1] + 7 * data[i + 2]) % 1000000007;
  }
  done({drawn, sum});
})))`);

try {
  let page = await open('all.html');
  await clean(page, 'all.html');
  const first = await state(page);
  console.log(`all.html: ${(statSync(inFolder('all.html')).size / 1e6).toFixed(2)} MB, first frame after ${Math.round(first.firstFrameMs)} ms`);

  // Names appear as text, not as markup.
  assert.equal(await page.value('window.hacked'), undefined);
  assert.equal(await page.value('document.querySelector("h1").textContent'), kMission);
  assert.equal(await page.value('document.querySelectorAll("#report img, #report b, #report script").length'), 0);
  assert.ok((await page.value('document.querySelector(".robots").textContent')).includes(kRobot));

  // Every layer draws items when it alone is visible, and the keyboard switches it.
  const ids = ['points', 'optimized', 'odometry', 'truth', 'kept', 'rejected', 'selected', 'beacons', 'radio'];
  for (const id of ids) assert.ok(first.layers[id]?.drawn > 0, `layer ${id}: ${JSON.stringify(first.layers[id])}`);
  assert.ok('outlier' in first.layers);
  const set = (id, on) => page.value(`(() => { const box = document.querySelector('[data-layer="${id}"]'); if (box.checked !== ${on}) box.click(); })()`);
  for (const id of Object.keys(first.layers)) await set(id, false);
  assert.equal((await pixels(page)).drawn, 0, 'all layers off');
  for (const id of ids) {
    await page.value(`document.querySelector('[data-layer="${id}"]').focus()`);
    await page.key(' ', 'Space', ' ');
    assert.equal((await state(page)).layers[id].on, true, `${id} by the space bar`);
    const { drawn } = await pixels(page);
    assert.ok(drawn > 50, `layer ${id} drew ${drawn} pixels`);
    await set(id, false);
  }
  await set('points', true);
  const looks = new Set();
  for (const mode of ['height', 'robot', 'observability']) {
    await page.value(`document.querySelector('input[value="${mode}"]').click()`);
    looks.add((await pixels(page)).sum);
  }
  assert.equal(looks.size, 3, 'each way to colour looks different');
  for (const button of ['From above', 'Whole map']) {
    const before = (await pixels(page)).sum;
    await page.value(`[...document.querySelectorAll('.views button')].find((b) => b.textContent === '${button}').click()`);
    assert.notEqual((await pixels(page)).sum, before, button);
  }

  // Charts and tables.
  for (const id of ['ratio', 'error', 'closures', 'robots', 'boxes-0']) assert.ok(first.charts[id] > 3, `chart ${id}: ${first.charts[id]} marks`);
  assert.equal(await page.value('document.querySelectorAll("tr[data-run]").length'), 3);
  assert.ok((await page.value('document.getElementById("report").textContent')).includes('parameters_sha256'));
  assert.ok((await page.value('document.getElementById("licences").textContent')).includes('three.js authors'));

  for (const id of ['ratio', 'error', 'closures']) assert.ok((await ticks(page, id)).length >= 3, `ticks of ${id}: ${await ticks(page, id)}`);
  assert.ok((await text(page, '.figures')).includes('Mean position error'));

  // Review of closures: looked at, decided on, saved, used.
  const listed = await page.value('document.querySelectorAll(".closure").length');
  assert.ok(listed > 3, `${listed} closures to review`);
  const inked = () => page.value(`[...document.querySelectorAll('.scans canvas')].map((canvas) => { const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data; let sum = 0; for (let i = 3; i < data.length; i += 4) sum += data[i] > 0 ? 1 + (i % 9973) : 0; return sum; })`);
  const byRegistration = await inked();
  assert.ok(byRegistration.every((sum) => sum > 0), `both views are drawn: ${byRegistration}`);
  await page.value(`document.querySelector('input[name="laying"][value="odometry"]').click()`);
  assert.notDeepEqual(await inked(), byRegistration, 'by odometry the scans lie otherwise');
  const press = (word) => page.value(`document.querySelector('button[data-decide="${word}"]').click()`);
  await press('reject');
  await page.value(`document.querySelector('.closure[data-closure="1"]').click()`);
  await press('accept');
  await page.value(`document.querySelector('.closure[data-closure="2"]').click()`);
  await press('reject');
  await press('');
  const { review } = await state(page);
  assert.equal(review.decisions, 2);
  const closures = await page.value('loopwiseReport.map.data.review.closures.map((c) => c.keys)');
  assert.equal(review.csv, `from,to,decision\n${closures[0].join()},reject\n${closures[1].join()},accept\n`);
  assert.equal(await text(page, '#save-decisions'), 'Save decisions.csv (2)');
  writeFileSync(inFolder('decisions.csv'), review.csv);
  loopwise('optimize', inFolder('obs'), '--gnc', '--decisions', inFolder('decisions.csv'), '--weights', inFolder('weights.csv'), '--quiet');
  const weights = readFileSync(inFolder('weights.csv'), 'utf8').trim().split('\n').slice(1).map((row) => row.split(','));
  const weightOf = ([from, to]) => weights.filter(([, a, b]) => (a === from && b === to) || (a === to && b === from)).map((row) => Number(row[3]));
  assert.deepEqual(weightOf(closures[0]), [], 'a rejected closure is not in the graph');
  assert.deepEqual(weightOf(closures[1]), [1], 'an accepted closure is kept');
  const onScreen = await page.value(`(() => {
    const { map } = loopwiseReport;
    map.view('top');
    const { from, to } = map.data.review.closures[3];
    const ends = [from, to].map((node) => map.camera.position.clone().fromArray(map.data.nodes.optimized, 3 * node).project(map.camera));
    const box = map.canvas.getBoundingClientRect();
    const [x, y] = [((ends[0].x + ends[1].x) / 4 + 0.5) * box.width, (0.5 - (ends[0].y + ends[1].y) / 4) * box.height];
    map.canvas.dispatchEvent(new MouseEvent('click', { clientX: box.left + x, clientY: box.top + y, bubbles: true }));
    return loopwiseReport.review.selected;
  })()`);
  assert.notEqual(onScreen, 2, 'a click on a closure selects it, or one that lies over it');

  // Another run.
  await page.value(`(() => { const s = document.getElementById('run'); s.value = '1'; s.dispatchEvent(new Event('change')); })()`);
  await page.until('loopwiseReport.ready === true && loopwiseReport.run === 1');
  assert.ok((await page.value('document.querySelector(".subtitle").textContent')).includes('baseline'));
  await clean(page, 'all.html');
  await page.screenshot(inFolder('all.png'));

  // Small and dark.
  page = await open('all.html', { width: 400, height: 800, dark: true });
  await clean(page, 'all.html');
  assert.ok(await page.value('document.documentElement.scrollWidth <= innerWidth'), 'no sideways scrolling on a phone');
  await page.screenshot(inFolder('small.png'));

  // Missing data are left out and listed in the notes.
  page = await open('alone.html');
  await clean(page, 'alone.html');
  const alone = await state(page);
  assert.ok(!('truth' in alone.layers) && !('beacons' in alone.layers));
  assert.ok(alone.layers.odometry.drawn > 0);
  assert.ok((await page.value('document.getElementById("notes").textContent')).includes('no mission given'));
  page = await open('bare.html');
  await clean(page, 'bare.html');
  const bare = await state(page);
  assert.deepEqual(Object.keys(bare.layers), ['optimized']);
  assert.ok((await page.value('document.getElementById("notes").textContent')).includes('no map.pcd'));
  page = await open('untrue.html');
  await clean(page, 'untrue.html');
  const untrue = await state(page);
  assert.ok(!('truth' in untrue.layers) && !('error' in untrue.charts) && !('robots' in untrue.charts));
  assert.ok(untrue.charts.ratio > 3 && untrue.layers.radio.drawn > 0);
  assert.ok(!(await page.value('document.querySelector(".charts").textContent')).includes('kept by GNCtrue'));
  assert.ok((await page.value('document.getElementById("notes").textContent')).includes('no ground truth'));

  // Without a truth: closures and residuals, no errors.
  for (const [name, reference] of [['untrue.html', false], ['referred.html', true]]) {
    if (name !== 'untrue.html') page = await open(name);
    await clean(page, name);
    const figures = await text(page, '.figures');
    assert.ok(/^Closures kept.*Residual of kept closures\d/.test(figures), figures);
    assert.ok(!/error|true|truth/i.test(figures + (await text(page, '.charts'))), `${name} speaks of errors`);
    assert.equal('reference' in (await state(page)).layers, reference);
    assert.equal((await text(page, '#report')).includes('Difference from the session’s own optimised poses'), reference);
  }
  page = await open('untrue.html');
  const mapTable = await text(page, '#map-quality');
  for (const part of ['displacement, mean3.250 m0.125 m', 'thickness of surfaces0.875 m0.042 m0.021 m', '3.0 %24.5 %25.5 %', '210 revisits on 62 % of the path', 'is -3.125 m, 95 % interval -4.500 to -1.750 m']) assert.ok(mapTable.includes(part), `no "${part}" in ${mapTable}`);
  page = await open('referred.html');
  const few = await text(page, '#map-quality');
  assert.ok(few.includes('Not meaningful: of 7 pairs <b>no</b> registration proves one') && !few.includes('3.250'), few);
  page = await open('maps.html');
  await clean(page, 'maps.html');
  assert.ok(/residualdisplacement/.test(await text(page, '#report')), 'a column of displacements');
  page = await open('judged.html');
  await clean(page, 'judged.html');
  assert.ok((await text(page, '.figures')).includes('Mean position error') && /\d+ are true/.test(await text(page, '.figures')));
  assert.ok('truth' in (await state(page)).layers && (await text(page, '#notes')).includes('errors over time are not known'));

  // Runs with odometry noise count as another mission, with other options as another method, with other seeds as repetitions.
  page = await open('noise.html');
  await clean(page, 'noise.html');
  const names = await page.value('[...document.querySelectorAll("#run option")].map((o) => o.textContent)');
  const [quiet, noise] = ['no odometry noise', 'odometry noise 0.01 rad/m, 0.05 m/m'];
  assert.equal(names.length, 4);
  for (const [i, parts] of [[quiet, 'obs'], [noise, 'obs, workers 10, seed 2'], [noise, 'obs, workers 10, seed 3'], [noise, 'obs, workers 3']].entries()) {
    for (const part of parts) assert.ok(names[i].includes(part), `run ${i} is called ${names[i]}, without ${part}`);
  }
  const charts = await text(page, '.charts');
  assert.ok(charts.includes(`Error by method`) && charts.includes(noise) && !charts.includes(`Error by method: ${JSON.parse(readFileSync(join(sample, 'mission.json'), 'utf8')).name}Each`), charts);

  // Studies.
  page = await open('study.html');
  await clean(page, 'study.html');
  const study = await state(page);
  assert.ok(study.charts['boxes-0'] > 20 && study.charts['boxes-1'] > 20, JSON.stringify(study.charts));
  const studied = await text(page, '#report');
  // Medians: full 1.3, baseline 4.3, odometry 4.3.
  for (const part of ['<b>urban</b>: 15 runs of 5 missions', '−70 %', '1.300', '8.000', '10 of 10', '−3.000 (−3.100 to −2.900)']) assert.ok(studied.includes(part), `no "${part}" in ${studied}`);
  assert.equal(await page.value('document.querySelectorAll("#report b").length'), 0);
  await page.screenshot(inFolder('study.png'));
  page = await open('others.html');
  await clean(page, 'others.html');
  assert.ok((await state(page)).charts['study-0'] > 3);
  const others = await page.value('document.getElementById("report").textContent');
  for (const part of ['full, workers 50', 'full-w50full-w103 of 3−0.800 (−0.900 to −0.700)0.500 (0.400 to 0.600)', '<i>husky</i>transl., % (largest, m)4.200 (4.00)2.200 (2.00)rot., °/m (largest, °)0.0125 (1.50)', '2 studies, 9 runs']) assert.ok(others.includes(part), `no "${part}" in ${others}`);
  assert.equal(await page.value('document.querySelectorAll("#report i.husky, #report td i, #report th i").length'), 0);
  page = await open('both.html');
  await clean(page, 'both.html');
  assert.ok((await state(page)).layers.points.drawn > 0);
  assert.ok(existsSync(inFolder('all.png')));

  // Without WebGL the map is a plan.
  await browser.close();
  browser = new Browser(chromium, ['--disable-3d-apis']);
  page = await open('all.html');
  await clean(page, 'all.html');
  const plan = await state(page);
  assert.equal(await page.value('document.querySelectorAll("#map canvas, .failure").length'), 0);
  assert.ok((await text(page, '#map')).includes('no WebGL'));
  assert.equal(await page.value('document.querySelectorAll("#map g[data-layer]").length'), Object.keys(plan.layers).length);
  const seen = (id) => page.value(`(() => { const g = document.querySelector('#map g[data-layer="${id}"]'); const b = g.getBBox(); return g.getAttribute('visibility') === 'visible' && (Math.max(b.width, b.height) > 1 || ('${id}' === 'beacons' && g.childElementCount > 0)); })()`); // a beacon is a dot: a stroke without extent
  for (const id of ['points', 'optimized', 'odometry', 'kept', 'beacons']) {
    assert.ok(await seen(id), `the plan shows no ${id}`);
    await page.value(`document.querySelector('input[data-layer="${id}"]').click()`);
    assert.ok(!(await seen(id)), `${id} switched off`);
    await page.value(`document.querySelector('input[data-layer="${id}"]').click()`);
  }
  assert.ok((await text(page, '.bar')).endsWith(' m'));
  assert.ok((await state(page)).charts.error > 3);
  await page.screenshot(inFolder('plan.png'));
  console.log('passed');
} finally {
  await browser.close();
}
