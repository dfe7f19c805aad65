// SPDX-License-Identifier: BSD-3-Clause
// Pictures of a report: node screenshot.mjs REPORT.html PREFIX [--dark] [--width N] [--charts N] [--tables] [--do JS]
// writes PREFIX_map.png, the first screen, PREFIX_charts.png, the first N charts or all, and PREFIX_tables.png. --do runs
// JavaScript in the page first. Prints the time to the map's first frame and all errors of the page.
import { resolve } from 'node:path';
import { pathToFileURL } from 'node:url';
import { Browser } from './browser.mjs';

const [report, prefix, ...rest] = process.argv.slice(2);
const option = (name, otherwise) => (rest.includes(name) ? rest[rest.indexOf(name) + 1] : otherwise);
const width = Number(option('--width', 1400));
const browser = new Browser(process.env.LOOPWISE_CHROMIUM ?? 'chromium');
const page = await browser.open(pathToFileURL(resolve(report)).href, { width, height: 900, dark: rest.includes('--dark') });
await page.until('window.loopwiseReport?.ready === true');
if (option('--do')) await page.value(option('--do'));
await new Promise((done) => setTimeout(done, 500));
const box = (selector) => page.value(`(() => { const r = document.querySelector('${selector}').getBoundingClientRect(); return {x: 0, y: r.top + scrollY, width: innerWidth, height: r.height}; })()`);
const map = await box('.maprow');
await page.screenshot(`${prefix}_map.png`, { x: 0, y: 0, width, height: map.y + map.height + 12 });
const charts = await box('.charts');
const last = await page.value(`[...document.querySelectorAll('.charts > .card')].slice(0, ${Number(option('--charts', 1000))}).pop()?.getBoundingClientRect().bottom + scrollY`);
await page.screenshot(`${prefix}_charts.png`, { ...charts, y: charts.y - 6, height: last - charts.y + 12 });
if (rest.includes('--tables')) {
  const top = charts.y + charts.height;
  await page.screenshot(`${prefix}_tables.png`, { x: 0, y: top, width, height: Math.min(2400, (await page.value('document.documentElement.scrollHeight')) - top) });
}
const state = await page.value('({firstFrameMs: loopwiseReport.firstFrameMs, charts: loopwiseReport.charts, layers: loopwiseReport.layers, errors: loopwiseReport.errors})');
process.stdout.write(`${JSON.stringify({ ...state, complaints: page.complaints, requests: page.requests }, null, 1)}\n`);
await browser.close();
