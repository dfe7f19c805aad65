// SPDX-License-Identifier: BSD-3-Clause
// Colours that readers with any colour vision tell apart (Okabe and Ito 2008; viridis for scales).

export const dark = () => matchMedia('(prefers-color-scheme: dark)').matches;

const kRobots = ['#0072b2', '#e69f00', '#009e73', '#cc79a7', '#56b4e9', '#d55e00'];
const kRobotsOnDark = ['#4aa8e0', '#f0b429', '#2fc79a', '#e39cc4', '#8fd0f5', '#f08a4b'];
export const robotColour = (robot) => (dark() ? kRobotsOnDark : kRobots)[robot % kRobots.length];

const kMethods = {
  odometry: ['#7a8590', '#97a3ae'],
  odom: ['#7a8590', '#97a3ae'],
  baseline: ['#d55e00', '#f08a4b'],
  random: ['#b8860b', '#f0b429'],
  obs: ['#0072b2', '#4aa8e0'],
  gi: ['#009e73', '#2fc79a'],
  full: ['#8b4fa8', '#c79be0'],
  rssi: ['#56b4e9', '#8fd0f5'],
};
const kOthers = [['#a0522d', '#d9a07a'], ['#4b5563', '#c3cad2'], ['#cc79a7', '#e39cc4']];
export function methodColour(method, others = 0) {
  const own = Object.hasOwn(kMethods, method) ? kMethods[method] : kOthers[others % kOthers.length];
  return own[dark() ? 1 : 0];
}

export function ink() {
  return dark()
    ? { text: '#e7ebef', soft: '#a3afba', line: '#2c353e', ground: '#12171c', truth: '#ffffff', kept: '#c79be0', outlier: '#ff7a45', rejected: '#77838f', selected: '#5b7f9c', radio: '#8fd0f5', beacon: '#ffffff' }
    : { text: '#1c2328', soft: '#5b6770', line: '#dde2e6', ground: '#fcfcfb', truth: '#101418', kept: '#7b3fa0', outlier: '#d1480a', rejected: '#9aa3ab', selected: '#8fb3cc', radio: '#2b8cc4', beacon: '#101418' };
}

const kViridis = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37]];
/** [r, g, b] of 0..255 for a share in [0, 1]. The ends that would vanish in the ground are left out. */
export function scale(share) {
  const [from, to] = dark() ? [0.22, 1] : [0.05, 0.86];
  const place = (from + Math.min(1, Math.max(0, share)) * (to - from)) * (kViridis.length - 1);
  const low = Math.min(kViridis.length - 2, Math.floor(place));
  const t = place - low;
  return kViridis[low].map((c, i) => c + t * (kViridis[low + 1][i] - c));
}
export const scaleGradient = () => `linear-gradient(to right, ${[0, 0.2, 0.4, 0.6, 0.8, 1].map((s) => `rgb(${scale(s).map(Math.round).join(' ')})`).join(', ')})`;
export const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
