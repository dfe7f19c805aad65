// SPDX-License-Identifier: BSD-3-Clause
// Bundles the report's page: `node build.mjs [--out DIR]` writes DIR/report.html, the page without data, and
// DIR/report_template.cpp, the same text for the program. `--notice` writes THIRD_PARTY.md as well.
import { readFileSync, writeFileSync, mkdirSync, readdirSync } from 'node:fs';
import { dirname, join, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';
import { build } from 'esbuild';

const here = dirname(fileURLToPath(import.meta.url));
const argument = (name, otherwise) => {
  const at = process.argv.indexOf(name);
  return at < 0 ? otherwise : process.argv[at + 1];
};
const out = resolve(argument('--out', join(here, 'dist')));

const bundle = async (entry, loader) => {
  const result = await build({
    entryPoints: [join(here, 'src', entry)],
    bundle: true,
    minify: true,
    write: false,
    metafile: true,
    format: 'iife',
    target: ['chrome109', 'firefox115', 'safari16'],
    charset: 'utf8',
    legalComments: 'none',
    logLevel: 'warning',
    absWorkingDir: here,
    ...loader,
  });
  return { text: result.outputFiles[0].text, inputs: Object.keys(result.metafile.outputs[Object.keys(result.metafile.outputs)[0]].inputs) };
};

/** The packages that ended up in the bundle, with the text of their licences. */
const notices = (inputs) => {
  const folders = new Set();
  for (const input of inputs) {
    const found = input.match(/^(.*node_modules\/(?:@[^/]+\/)?[^/]+)\//);
    if (found) folders.add(found[1]);
  }
  return [...folders].sort().map((folder) => {
    const about = JSON.parse(readFileSync(join(here, folder, 'package.json'), 'utf8'));
    const file = readdirSync(join(here, folder)).find((name) => /^licen[cs]e/i.test(name));
    return {
      name: about.name,
      version: about.version,
      license: about.license,
      text: file ? readFileSync(join(here, folder, file), 'utf8').trim().replace(/\r/g, '') : '',
    };
  });
};

/** Packages of the same authors share one text: each is given once. */
const grouped = (packages) => {
  const groups = new Map();
  for (const one of packages) {
    const key = one.text || one.license;
    if (!groups.has(key)) groups.set(key, []);
    groups.get(key).push(one);
  }
  return [...groups.values()];
};

const script = await bundle('main.js', {});
const style = await bundle('style.css', {});
const packages = notices(script.inputs);
for (const { name, license } of packages) {
  if (!['MIT', 'ISC', 'BSD-3-Clause', '0BSD', 'Apache-2.0'].includes(license)) {
    throw new Error(`${name}: licence ${license} is not one that may be bundled`);
  }
}

const licences = grouped(packages)
  .map((group) => `${group.map((p) => `${p.name} ${p.version} (${p.license})`).join(', ')}\n\n${group[0].text}\n`)
  .join('\n----------------------------------------\n\n');

if (process.argv.includes('--notice')) {
  const rows = packages.map((p) => `| ${p.name} | ${p.version} | ${p.license} |`).join('\n');
  writeFileSync(
    join(here, 'THIRD_PARTY.md'),
    `# What the report's page contains of others\n\nPages that \`loopwise report\` writes, and programs that can write them, hold these packages.\n` +
      `\`node build.mjs --notice\` makes this file.\n\n| package | version | licence |\n| --- | --- | --- |\n${rows}\n\n## Texts\n\n` +
      grouped(packages)
        .map((group) => `### ${group.map((p) => p.name).join(', ')}\n\n\`\`\`text\n${group[0].text}\n\`\`\`\n`)
        .join('\n'),
  );
}

const inScript = (text) => text.replace(/<\/(script)/gi, '<\\/$1').replace(/<!--/g, '<\\!--');
const inText = (text) => text.replace(/&/g, '&amp;').replace(/</g, '&lt;');
const page = readFileSync(join(here, 'src', 'page.html'), 'utf8')
  .replace('@STYLE@', () => style.text.trim())
  .replace('@LICENCES@', () => inText(licences))
  .replace('@SCRIPT@', () => inScript(script.text.trim()));
const mark = '@LOOPWISE_DATA@';
if (page.split(mark).length !== 2) throw new Error('the page must hold the place of the data once');

/** C++ string literals of at most a few kB each, which compilers join. */
const literals = (text) => {
  const bytes = Buffer.from(text, 'utf8');
  const lines = [];
  for (let at = 0; at < bytes.length; at += 4000) {
    let line = '';
    for (const byte of bytes.subarray(at, at + 4000)) {
      if (byte === 0x22 || byte === 0x5c || byte === 0x3f) line += `\\${String.fromCharCode(byte)}`;
      else if (byte >= 0x20 && byte < 0x7f) line += String.fromCharCode(byte);
      else line += `\\${byte.toString(8).padStart(3, '0')}`;
    }
    lines.push(`    "${line}"`);
  }
  return { text: lines.join('\n'), size: bytes.length };
};

mkdirSync(out, { recursive: true });
writeFileSync(join(out, 'report.html'), page);
const { text, size } = literals(page);
writeFileSync(
  join(out, 'report_template.cpp'),
  `// Made by web/build.mjs.\n#include "report_template.hpp"\n\nnamespace loopwise {\n\nstd::string_view report_template() {\n` +
    `  return {\n${text},\n      ${size}};\n}\n\n}  // namespace loopwise\n`,
);
process.stderr.write(`report: page of ${(size / 1e6).toFixed(2)} MB in ${out}\n`);
