// SPDX-License-Identifier: BSD-3-Clause
// Elements and figures. Text from outside becomes text nodes alone, never markup.

/** h('p', {class: 'note', onclick: f}, 'text', child): attributes as they stand, on* as listeners. */
export function h(name, attributes, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (key.startsWith('on')) element.addEventListener(key.slice(2), value);
    else element.setAttribute(key, value === true ? '' : String(value));
  }
  for (const child of children.flat(2)) {
    if (child !== undefined && child !== null && child !== false) element.append(child);
  }
  return element;
}

export const isNumber = (value) => typeof value === 'number' && Number.isFinite(value);

const grouped = new Intl.NumberFormat('en', { maximumFractionDigits: 0, useGrouping: true });
/** 66 236 */
export const count = (value) => (isNumber(value) ? grouped.format(value).replace(/,/g, '\u202f') : '–');
export const fixed = (value, digits) => (isNumber(value) ? value.toFixed(digits) : '–');
/** Metres with as many digits as they deserve. */
export const metres = (value) => (isNumber(value) ? `${value.toFixed(value < 10 ? 3 : value < 100 ? 2 : 1)} m` : '–');
export const percent = (part, whole) => (isNumber(part) && isNumber(whole) && whole > 0 ? `${((100 * part) / whole).toFixed(2)} %` : '–');
export function duration(seconds) {
  if (!isNumber(seconds)) return '–';
  if (seconds < 120) return `${seconds.toFixed(seconds < 10 ? 1 : 0)} s`;
  if (seconds < 3600) return `${(seconds / 60).toFixed(1)} min`;
  const minutes = Math.round(seconds / 60);
  return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

/** A value within nested objects, or undefined. */
export const at = (object, ...path) => path.reduce((value, key) => (value === null || value === undefined ? undefined : value[key]), object);

/** A table of rows of texts and elements; columns after the first are right-aligned. */
export function table(caption, head, rows, attributes = {}) {
  return h('div', { class: 'scroll' },
    h('table', attributes,
      caption && h('caption', {}, caption),
      h('thead', {}, h('tr', {}, head.map((text) => h('th', { scope: 'col' }, text)))),
      h('tbody', {}, rows.map((row) => h('tr', row.attributes ?? {}, (row.cells ?? row).map((text, i) => (i === 0 ? h('th', { scope: 'row' }, text) : h('td', {}, text))))))));
}
