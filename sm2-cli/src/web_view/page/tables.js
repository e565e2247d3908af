// Tables of topics and nodes: the same content as the graph, for screen readers and for sorting.

import { h } from './dom.js';
import { isPeer } from './domain.js';
import * as text from './text.js';

const COLUMNS = {
  topics: [
    ['Topic or service', (it) => it.name],
    ['Type', (it) => typeOf(it.faces)],
    ['Sources', (it) => it.faces.filter(isSource).length],
    ['Receivers', (it) => it.faces.filter((face) => !isSource(face)).length],
    ['Rate', (it) => it.rate, text.rate],
    ['Bandwidth', (it) => it.bytes, text.bandwidth],
    ['Median delay', (it) => it.delay, (ns) => text.duration(ns == null ? null : ns / 1e6)],
    ['Dropped', (it) => it.dropped, text.number],
    ['Lost', (it) => it.lost, text.number],
  ],
  nodes: [
    ['Node', (it) => it.name],
    ['Process', (it) => it.node?.pid],
    ['Interfaces', (it) => it.faces.length],
    ['Sends', (it) => it.rate, text.rate],
    ['Sends bytes', (it) => it.bytes, text.bandwidth],
    ['Receives', (it) => it.inRate, text.rate],
    ['Receives bytes', (it) => it.inBytes, text.bandwidth],
    ['Dropped', (it) => it.dropped, text.number],
    ['Lost', (it) => it.lost, text.number],
  ],
};

// A table of `kind`, `topics` or `nodes`. `sort` is `{ column, isDown }`; `actions` has `select` and `sortBy`.
export function table(kind, domain, { filter, sort, selected }, actions) {
  const columns = COLUMNS[kind];
  const rows = [...domain.vertices.values()]
    .filter((it) => (it.kind === 'node') === (kind === 'nodes'))
    .filter((it) => it.name.toLowerCase().includes(filter));
  const value = columns[sort.column][1];
  const sign = sort.isDown ? -1 : 1;
  rows.sort((one, other) => sign * compare(value(one), value(other)) || compare(one.name, other.name));
  const heads = columns.map(([title], at) => h('th', {
    key: title, scope: 'col', 'aria-sort': at !== sort.column ? 'none' : sort.isDown ? 'descending' : 'ascending',
  }, h('button', { type: 'button', onclick: () => actions.sortBy(at) }, title)));
  return h('div', { key: kind, class: 'scroll' }, h('table', { class: 'list' },
    h('caption', { class: 'hidden' }, kind === 'nodes' ? 'Nodes' : 'Topics and services'),
    h('thead', {}, h('tr', {}, heads)),
    h('tbody', { onkeydown: (event) => step(event, 'tr') }, rows.map((row) => h('tr', {
      key: row.id, class: row.id === selected ? 'selected' : null,
    }, columns.map(([, of, show], at) => at === 0
      ? h('th', { scope: 'row' }, chip(row.id, row.kind, row.name, actions))
      : h('td', { class: show || at > 1 ? 'number' : null }, (show ?? String)(of(row) ?? null))))))));
}

function compare(one, other) {
  if (typeof one === 'string') {
    return one < other ? -1 : one > other ? 1 : 0;
  }
  return (one ?? -1) - (other ?? -1);
}

export function isSource(face) {
  return face.kind === 'publisher' || face.kind === 'client';
}

export function typeOf(faces) {
  const names = faces.flatMap((face) => face.type
    ? [face.type.name]
    : face.request ? [`${face.request.name} → ${face.reply?.name ?? '?'}`] : []);
  return names[0] ?? 'any type';
}

// A button with a name, which selects a vertex.
export function chip(id, kind, name, actions) {
  const peer = kind === 'node' && isPeer(name) ? ' peer' : '';
  return h('button', {
    key: id, type: 'button', class: `chip ${kind}${peer}`, title: `${kind} ${name}`, onclick: () => actions.select(id),
  }, name);
}

// Moves the focus with the up and down arrows, between the first buttons of `tag` elements.
export function step(event, tag) {
  const move = { ArrowDown: 'nextElementSibling', ArrowUp: 'previousElementSibling' }[event.key];
  const next = move && event.target.closest(tag)?.[move]?.querySelector('button');
  if (next) {
    event.preventDefault();
    next.focus();
  }
}
