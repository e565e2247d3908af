// The panel beside the graph: the domain as a whole, or the selected node, topic, service or edge.

import { h } from './dom.js';
import { groupOf, history, isPeer, nodeId } from './domain.js';
import { chip, isSource, step, typeOf } from './tables.js';
import * as text from './text.js';

const SPARK_WIDTH = 300;
const SPARK_HEIGHT = 36;
// How many quotas are shown.
const QUOTAS = 3;
// How many pairs without a link are listed.
const PAIRS_MAX = 20;

// The content of the panel. `actions` has `select`, `collapse` (a group of names), `why` (asks why two interfaces are
// not linked), `schema` (asks for the types of a topic or service) and `gateways` (asks gateways for reports);
// `answers` has the answers so far, by question.
export function panel(domain, selected, answers, actions) {
  const vertex = domain.vertices.get(selected);
  const edge = domain.edges.get(selected);
  const page = { domain, answers, actions };
  if (vertex) {
    return vertex.kind === 'node' ? nodePage(page, vertex) : subjectPage(page, vertex);
  }
  return edge ? edgePage(page, edge) : overview(page);
}

function overview({ domain, answers, actions }) {
  const { sample, vertices } = domain;
  const bad = sample.checks.filter((check) => check.level !== 'ok');
  const warnings = bad.map((check) => h('li', { key: check.check, class: check.level },
    h('strong', {}, check.check), ` ${check.found}`, check.advice && h('p', {}, check.advice)));
  const { open, without_counters: silent } = sample.domain;
  const unlinked = open.map((it) => h('li', { key: `${it.offering} ${it.demanding} ${it.by}` },
    it.item === 'claim'
      ? `${it.by} claims link ${it.link}`
      : `${it.offering} → ${it.demanding}: ${it.reason ?? 'waits for room'}`));
  return [
    heading('Domain', null, actions),
    facts([
      ['Manager', sample.connected ? `epoch ${sample.domain.epoch ?? 'unknown'}` : 'none is connected'],
      ['Revision', text.number(sample.domain.revision)],
      ['Nodes', text.number(sample.domain.nodes.length)],
      ['Interfaces', text.number(sample.domain.interfaces.length)],
      ['Links', text.number(sample.domain.links.length)],
    ]),
    section('Warnings', warnings.length === 0
      ? note('All checks of sm2 doctor are ok.')
      : h('ul', { class: 'checks' }, warnings)),
    unlinked.length > 0 && section('Matching pairs without a link', h('ul', {}, unlinked)),
    silent.length > 0 && section('Nodes without counters', note(silent.join(', '))),
    others(vertices, answers, actions),
    section('Most used quotas', quotas(sample.domain.quotas)),
    section('Last events', eventList(sample.events, actions)),
  ];
}

// The connections to other domains: gateways, and the nodes that stand for their peers.
function others(vertices, answers, actions) {
  const all = [...vertices.values()];
  const peers = all.filter((it) => it.kind === 'node' && isPeer(it.name));
  const gateways = all.filter((it) => it.kind === 'service' && /^gateway\/.+\/status$/.test(it.name));
  if (peers.length + gateways.length === 0) {
    return null;
  }
  const reports = answers.get('gateways');
  return section('Other domains',
    h('ul', { class: 'rows' }, peers.map((it) => h('li', { key: it.id },
      chip(it.id, 'node', it.name, actions), h('span', {}, ` in ${text.rate(it.rate)}, out ${text.rate(it.inRate)}`)))),
    h('ul', { class: 'rows' }, gateways.map((it) => h('li', { key: it.id },
      chip(it.id, 'service', it.name.split('/').slice(1, -1).join('/'), actions), ' gateway'))),
    gateways.length > 0 && h('button', { type: 'button', onclick: actions.gateways }, 'Ask the gateways for a report'),
    answer(reports));
}

function nodePage(page, vertex) {
  const { domain, actions } = page;
  const { node, faces } = vertex;
  const links = domain.sample.domain.links.filter((link) => ends(link).some(([of]) => of === vertex.name));
  return [
    heading(vertex.name, isPeer(vertex.name) ? 'node for a peer of a gateway' : 'node', actions),
    node && facts([
      ['Process', `${node.pid} of user ${node.uid}`],
      ['Number', text.number(node.id)],
      ['State', node.resuming ? 'claims its links again' : 'ready'],
      ['Sends', `${text.rate(vertex.rate)}, ${text.bandwidth(vertex.bytes)}`],
      ['Receives', `${text.rate(vertex.inRate)}, ${text.bandwidth(vertex.inBytes)}`],
      ['Dropped, lost', `${text.number(vertex.dropped)}, ${text.number(vertex.lost)}`],
    ]),
    sparks(vertex),
    section('Interfaces', faceList(page, faces, (face) => {
      const kind = face.kind === 'server' || face.kind === 'client' ? 'service' : 'topic';
      return [`${kind[0]}:${face.name}`, kind, face.name];
    })),
    section('Links', linkList(links)),
    section('Last events', eventList(domain.sample.events.filter((it) => it.node === vertex.name), actions)),
  ];
}

function subjectPage(page, vertex) {
  const { domain, actions } = page;
  const links = domain.sample.domain.links.filter((link) => ends(link)[0][1] === vertex.name);
  return [
    heading(vertex.name, vertex.kind, actions),
    facts([
      ['Type', typeOf(vertex.faces)],
      ['Rate', `${text.rate(vertex.rate)}, ${text.bandwidth(vertex.bytes)}`],
      ['Median delay', text.duration(vertex.delay == null ? null : vertex.delay / 1e6)],
      ['Dropped, lost', `${text.number(vertex.dropped)}, ${text.number(vertex.lost)}`],
    ]),
    sparks(vertex),
    section('Schema',
      h('button', { type: 'button', onclick: () => actions.schema(vertex.name) }, 'Show the fields of a message'),
      answer(page.answers.get(`schema ${vertex.name}`))),
    section('Interfaces', faceList(page, vertex.faces, (face) => [nodeId(face.node), 'node', face.node])),
    pairs(page, vertex, links),
    section('Links', linkList(links)),
    section('Last events', eventList(domain.sample.events.filter((it) => it.name === vertex.name), actions)),
  ];
}

function edgePage(page, edge) {
  const { domain, actions } = page;
  const [from, to] = [domain.vertices.get(edge.from), domain.vertices.get(edge.to)];
  const node = from.kind === 'node' ? from : to;
  const subject = from.kind === 'node' ? to : from;
  const links = domain.sample.domain.links.filter((link) => {
    return ends(link).some(([of, name]) => of === node.name && name === subject.name);
  });
  return [
    heading(`${from.name} → ${to.name}`, edge.faces.map((face) => face.kind).join(', '), actions),
    h('p', {}, chip(from.id, from.kind, from.name, actions), ' → ', chip(to.id, to.kind, to.name, actions)),
    facts([
      ['Rate', `${text.rate(edge.rate ?? edge.inRate)}, ${text.bandwidth(edge.bytes ?? edge.inBytes)}`],
      ['Median delay', text.duration(edge.delay == null ? null : edge.delay / 1e6)],
      ['Dropped, lost', `${text.number(edge.dropped)}, ${text.number(edge.lost)}`],
    ]),
    section('Interfaces', faceList(page, edge.faces, (face) => [nodeId(face.node), 'node', face.node])),
    section('Links', linkList(links)),
  ];
}

// Interfaces, each with the name at its other side, its quality of service, and the reason for which it has no link.
function faceList({ answers, actions }, faces, other) {
  if (faces.length === 0) {
    return note('none');
  }
  return h('ul', { class: 'rows', onkeydown: (event) => step(event, 'li') }, faces.map((face) => {
    const title = `${face.node}:${face.name}`;
    const question = `why ${title}`;
    const rate = isSource(face) ? face.figures?.out_per_s : face.figures?.in_per_s;
    return h('li', { key: `${face.node_id}.${face.interface}` },
      h('div', { class: 'row' }, h('span', { class: 'kind' }, face.kind), chip(...other(face), actions),
        h('span', { class: 'number' }, text.rate(rate))),
      h('p', { class: 'muted' },
        `${typeOf([face])} · ${qos(face.qos)} · ${face.links} ${face.links === 1 ? 'link' : 'links'}`),
      face.refused && h('p', { class: 'bad' }, `refused: ${face.refused}`),
      face.links === 0 && h('button', {
        type: 'button', onclick: () => actions.why(question, title),
      }, 'Why is it not linked?'),
      answer(answers.get(question)));
  }));
}

// The publishers and subscribers of a topic that are not linked, each pair with a button for the reason.
function pairs({ domain, answers, actions }, vertex, links) {
  const linked = new Set(links.map((link) => `${link.offering} ${link.demanding}`));
  const offering = vertex.faces.filter((face) => face.kind === 'publisher' || face.kind === 'server');
  const demanding = vertex.faces.filter((face) => face.kind === 'subscriber' || face.kind === 'client');
  const title = (face) => `${face.node}:${face.name}`;
  const missing = offering.flatMap((one) => demanding.map((other) => [title(one), title(other)]))
    .filter(([one, other]) => !linked.has(`${one} ${other}`));
  if (missing.length === 0 || domain.sample.domain.links.length === 0 && offering.length === 0) {
    return null;
  }
  return section('Pairs without a link', h('ul', { class: 'rows' }, missing.slice(0, PAIRS_MAX).map(([one, other]) => {
    const question = `why ${one} ${other}`;
    return h('li', { key: question }, h('p', {}, `${one} → ${other}`),
      h('button', { type: 'button', onclick: () => actions.why(question, one, other) }, 'Why?'),
      answer(answers.get(question)));
  })), missing.length > PAIRS_MAX && note(`and ${missing.length - PAIRS_MAX} more`));
}

function qos(of) {
  const parts = [`depth ${of.depth}`];
  const add = (isSet, part) => isSet && parts.push(part);
  add(of.reliable, 'reliable');
  add(of.latched > 0, `latched ${of.latched}`);
  add(of.max_borrowed != null, `borrows ${of.max_borrowed}`);
  add(of.sealed, 'sealed');
  add(of.deadline_ns, `deadline ${text.duration(of.deadline_ns / 1e6)}`);
  add(of.lifespan_ns, `lifespan ${text.duration(of.lifespan_ns / 1e6)}`);
  add(of.liveliness_ns, `liveliness ${text.duration(of.liveliness_ns / 1e6)}`);
  return parts.join(', ');
}

// The node and the name of both interfaces of a link. A name never has a colon.
function ends(link) {
  return [link.offering.split(':'), link.demanding.split(':')];
}

function linkList(links) {
  if (links.length === 0) {
    return note('none');
  }
  return h('ul', { class: 'rows' }, links.map((link) => {
    const { offered, in_flight: inFlight, delivered, ...drops } = link.counters ?? {};
    const terms = [link.reliable && 'reliable', link.sealed && 'sealed'].filter(Boolean).join(', ') || 'best effort';
    const dropped = Object.entries(drops).filter(([, count]) => count > 0);
    return h('li', { key: link.link },
      h('p', {}, `${link.offering} → ${link.demanding}`), h('p', { class: 'muted' }, `${terms} · link ${link.link}`),
      link.counters
        ? h('p', { class: 'account' },
          `offered ${text.number(offered)} = delivered ${text.number(delivered)} + in flight ${text.number(inFlight)}`,
          dropped.map(([reason, count]) => h('span', { key: reason, class: 'bad' },
            ` + ${reason.replace('_', ' ')} ${text.number(count)}`)))
        : h('p', { class: 'muted' }, 'the sender keeps no counters'),
      link.taken && h('p', { class: 'account' },
        `taken ${text.number(link.taken.messages)} (${text.size(link.taken.bytes)}), `,
        h('span', { class: link.taken.lost > 0 ? 'bad' : null }, `lost ${text.number(link.taken.lost)}`),
        link.taken.delay_p50_ms != null && `, median delay ${text.duration(link.taken.delay_p50_ms)}`));
  }));
}

function quotas(all) {
  const most = [...all].sort((one, other) => other.used / other.limit - one.used / one.limit).slice(0, QUOTAS);
  return h('ul', { class: 'rows' }, most.map((it) => h('li', { key: `${it.of} ${it.quota}` },
    h('div', { class: 'row' }, h('span', {}, `${it.of}: ${it.quota}`),
      h('span', { class: 'number' }, `${text.number(it.used)} of ${text.number(it.limit)}`)),
    h('meter', {
      min: 0, max: it.limit, high: it.limit * 0.8, value: it.used, 'aria-label': `${it.of}: ${it.quota}`,
    }))));
}

function eventList(events, actions) {
  if (events.length === 0) {
    return note('none since sm2 view started');
  }
  const newest = [...events].reverse();
  return h('ol', { class: 'events', onkeydown: (event) => step(event, 'li') }, newest.map((it) => h('li', {
    key: it.number, class: it.kind,
  },
  h('time', { datetime: new Date(it.at_ms).toISOString() }, new Date(it.at_ms).toLocaleTimeString()),
  h('span', { class: 'kind' }, it.kind.replace('_', '-')),
  it.node !== null && chip(nodeId(it.node), 'node', it.node, actions), h('span', {}, it.text))));
}

function sparks(vertex) {
  return section('Last three minutes',
    spark(history(vertex.id, 'rate'), 'rate', text.rate),
    spark(history(vertex.id, 'bytes'), 'bandwidth', text.bandwidth));
}

function spark(values, title, show) {
  const top = Math.max(...values.map((value) => value ?? 0), 1e-9);
  const step = SPARK_WIDTH / 180;
  const start = SPARK_WIDTH - (values.length - 1) * step;
  const height = (value) => SPARK_HEIGHT - 2 - (SPARK_HEIGHT - 4) * value / top;
  const point = (value, at) => `${(start + at * step).toFixed(1)},${height(value).toFixed(1)}`;
  const points = values.map((value, at) => value == null ? null : point(value, at)).filter(Boolean);
  const label = `${title}: now ${show(values.at(-1))}, at most ${show(top < 1e-6 ? 0 : top)}`;
  return h('figure', { key: title },
    h('svg', { viewBox: `0 0 ${SPARK_WIDTH} ${SPARK_HEIGHT}`, role: 'img', 'aria-label': label, class: 'spark' },
      h('polyline', { points: points.join(' ') })),
    h('figcaption', {}, label));
}

function heading(name, kind, actions) {
  const group = kind && groupOf(name);
  return h('div', { class: 'heading', key: 'heading' }, h('h2', {}, name, kind && h('small', {}, kind)),
    group && h('button', {
      key: 'collapse', type: 'button', title: `Show ${group}/… as one`, onclick: () => actions.collapse(group),
    }, 'Collapse'),
    kind && h('button', {
      key: 'close', type: 'button', 'aria-label': 'Close the details', title: 'Close (Esc)',
      onclick: () => actions.select(null),
    }, '×'));
}

function facts(rows) {
  return h('dl', { key: 'facts' }, rows.map(([name, value]) => h('div', { key: name },
    h('dt', {}, name), h('dd', {}, value))));
}

function section(title, ...content) {
  return h('section', { key: title }, h('h3', {}, title), content);
}

function note(line) {
  return h('p', { class: 'muted' }, line);
}

function answer(lines) {
  return lines && h('div', { class: 'answer', role: 'status' }, lines.map((line) => h('p', {}, line)));
}
