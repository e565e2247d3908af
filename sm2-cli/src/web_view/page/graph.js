// Draws the graph as SVG, with pan and zoom. Arrow keys move between vertices, Enter selects one.

import { h, patch } from './dom.js';
import { isPeer } from './domain.js';
import { layout } from './layout.js';
import { isSource } from './tables.js';
import * as text from './text.js';

const MARGIN = 24;
const ZOOM_MIN = 0.05;
const ZOOM_MAX = 2.5;
// No zoom beyond this when the whole graph is shown.
const FIT_MAX = 1.3;
// With more edges than this, only those of the selection have labels.
const LABELS_MAX = 40;
const NAME_MAX = 34;

const ruler = document.createElement('canvas').getContext('2d');

export class Graph {
  #stage;
  #svg = null;
  #select;
  #structure = '';
  #layout = null;
  #graph = null;
  #selected = null;
  #focused = null;
  #view = { x: 0, y: 0, zoom: 1 };
  // Whether the person has moved the view: then it does not follow the graph.
  #isMoved = false;

  // `select` is called with the id of a vertex or edge, or null.
  constructor(stage, select) {
    this.#stage = stage;
    this.#select = select;
    new ResizeObserver(() => this.#fit(false)).observe(stage);
  }

  // Shows a graph of `domain.graph`, with one vertex or edge selected.
  show(graph, selected) {
    this.#graph = graph;
    this.#selected = selected;
    const structure = [...graph.vertices.keys(), ...graph.edges.keys()].join('\n');
    const isNew = structure !== this.#structure || this.#layout === null;
    if (isNew) {
      this.#structure = structure;
      const sizes = new Map([...graph.vertices.values()].map((vertex) => [vertex.id, sizeOf(vertex)]));
      const { clientWidth, clientHeight } = this.#stage;
      this.#layout = layout(sizes, [...graph.edges.values()], clientWidth / Math.max(clientHeight, 1));
      this.#layout.sizes = sizes;
    }
    this.#draw();
    if (isNew) {
      this.#fit(false);
    }
  }

  // Shows the whole graph; `always` also if the person has moved the view.
  fit() {
    this.#fit(true);
  }

  zoom(factor) {
    const { clientWidth, clientHeight } = this.#stage;
    this.#zoomAt(clientWidth / 2, clientHeight / 2, factor);
  }

  #draw() {
    const { vertices, edges } = this.#graph;
    const near = this.#neighbours();
    const labels = edges.size <= LABELS_MAX;
    const lines = [...edges.values()].map((edge) => this.#edge(edge, near, labels));
    const boxes = [...vertices.values()].map((vertex) => this.#vertex(vertex, near));
    patch(this.#stage, h('svg', {
      key: 'graph',
      class: near ? 'graph has-selection' : 'graph',
      role: 'group',
      'aria-label': `Graph of ${vertices.size} vertices and ${edges.size} edges; the tables show the same`,
      onwheel: (event) => this.#wheel(event),
      onpointerdown: (event) => this.#drag(event),
      onkeydown: (event) => this.#key(event),
    }, h('g', { class: 'view' }, h('g', {}, lines), h('g', {}, boxes))));
    this.#svg = this.#stage.querySelector('svg');
    this.#move();
  }

  // The ids that belong to the selection, or null without one.
  #neighbours() {
    const { vertices, edges } = this.#graph;
    const edge = edges.get(this.#selected);
    if (edge) {
      return new Set([edge.id, edge.from, edge.to]);
    }
    if (!vertices.has(this.#selected)) {
      return null;
    }
    const near = new Set([this.#selected]);
    for (const { id, from, to } of edges.values()) {
      if (from === this.#selected || to === this.#selected) {
        near.add(id).add(from).add(to);
      }
    }
    return near;
  }

  #edge(edge, near, labels) {
    const { points, isTurned } = this.#layout.routes.get(edge.id);
    const classes = ['edge', edge.kind, stateOf(edge)];
    if (near) {
      classes.push(near.has(edge.id) ? 'near' : 'far');
    }
    const { isDown } = this.#layout;
    const path = curve(points, isDown);
    const label = labels || near?.has(edge.id) ? this.#labelOf(edge) : '';
    const at = labelPlace(points, edge.isSource !== isTurned, isDown, isTurned);
    const losses = lossesOf(edge);
    const choose = (event) => { event.stopPropagation(); this.#select(edge.id); };
    return h('g', { key: edge.id, class: classes.join(' '), onclick: choose },
      h('title', {}, titleOf(edge)),
      h('path', { class: 'hit', d: path }),
      h('path', { class: 'line', d: path, 'stroke-width': widthOf(edge) }),
      h('path', { class: 'arrow', d: arrow(points, isTurned, isDown) }),
      (label || losses) && h('text', { class: 'label', ...at }, label,
        losses && h('tspan', { class: 'losses' }, ` ${losses}`)));
  }

  // Without the figures of a topic's only source: the topic shows the same.
  #labelOf(edge) {
    const subject = edge.isSource && this.#graph.vertices.get(edge.to);
    const isOnly = subject?.faces?.filter(isSource).length === 1 && edge.links > 0;
    return isOnly ? '' : labelOf(edge);
  }

  #vertex(vertex, near) {
    const { x, y } = this.#layout.places.get(vertex.id);
    const { width, height, name } = this.#layout.sizes.get(vertex.id);
    const classes = ['vertex', vertex.kind];
    if (vertex.kind === 'node' && isPeer(vertex.name)) {
      classes.push('peer');
    }
    if (vertex.faces?.some((face) => face.refused)) {
      classes.push('refused');
    }
    if (near) {
      classes.push(near.has(vertex.id) ? 'near' : 'far');
    }
    const isSelected = vertex.id === this.#selected;
    if (isSelected) {
      classes.push('selected');
    }
    const first = this.#focused ?? this.#graph.vertices.keys().next().value;
    const round = vertex.kind === 'topic' || vertex.kind === 'service' ? height / 2 : 7;
    const box = (grow) => ({ x: -width / 2 + grow, y: -height / 2 - grow, width, height, rx: round });
    return h('g', {
      key: vertex.id,
      class: classes.join(' '),
      transform: `translate(${x} ${y})`,
      role: 'button',
      tabindex: vertex.id === first ? 0 : -1,
      'data-id': vertex.id,
      'aria-label': `${vertex.kind} ${vertex.name}, ${metricOf(vertex)}`,
      'aria-pressed': String(isSelected),
      onclick: (event) => { event.stopPropagation(); this.#select(vertex.id); },
      onfocus: () => { this.#focused = vertex.id; },
    },
    h('title', {}, `${vertex.kind} ${vertex.name}`),
    vertex.kind === 'group' && h('rect', { class: 'behind', ...box(4) }),
    h('rect', { class: 'box', ...box(0) }),
    h('text', { class: 'name', y: -3 }, name),
    h('text', { class: 'metric', y: 12 }, metricOf(vertex)));
  }

  #fit(always) {
    if (!this.#layout || (this.#isMoved && !always)) {
      return;
    }
    this.#isMoved = false;
    const { width, height } = this.#layout;
    const { clientWidth, clientHeight } = this.#stage;
    const zoom = Math.min((clientWidth - 2 * MARGIN) / width, (clientHeight - 2 * MARGIN) / height, FIT_MAX);
    this.#view = {
      zoom: Math.max(zoom, ZOOM_MIN),
      x: (clientWidth - width * zoom) / 2,
      y: (clientHeight - height * zoom) / 2,
    };
    this.#move();
  }

  #move() {
    const { x, y, zoom } = this.#view;
    this.#svg?.querySelector('.view').setAttribute('transform', `translate(${x} ${y}) scale(${zoom})`);
  }

  #zoomAt(x, y, factor) {
    const view = this.#view;
    const zoom = Math.min(Math.max(view.zoom * factor, ZOOM_MIN), ZOOM_MAX);
    view.x = x - (x - view.x) * zoom / view.zoom;
    view.y = y - (y - view.y) * zoom / view.zoom;
    view.zoom = zoom;
    this.#isMoved = true;
    this.#move();
  }

  #wheel(event) {
    event.preventDefault();
    const { left, top } = this.#stage.getBoundingClientRect();
    this.#zoomAt(event.clientX - left, event.clientY - top, Math.exp(-event.deltaY / 500));
  }

  #drag(event) {
    if (event.button !== 0 || event.target.closest('.vertex, .edge')) {
      return;
    }
    const svg = this.#svg;
    let distance = 0;
    svg.setPointerCapture(event.pointerId);
    svg.onpointermove = (move) => {
      distance += Math.abs(move.movementX) + Math.abs(move.movementY);
      this.#view.x += move.movementX;
      this.#view.y += move.movementY;
      this.#isMoved = true;
      this.#move();
    };
    svg.onpointerup = () => {
      svg.onpointermove = svg.onpointerup = null;
      if (distance < 4) {
        this.#select(null);
      }
    };
  }

  #key(event) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = steps[event.key];
    const id = event.target.dataset?.id;
    if (event.key === 'Enter' || event.key === ' ') {
      event.preventDefault();
      this.#select(id ?? null);
    } else if (step && id) {
      event.preventDefault();
      const next = this.#towards(id, step);
      this.#svg.querySelector(`[data-id="${CSS.escape(next)}"]`).focus();
    }
  }

  // The nearest vertex in a direction, or the vertex itself.
  #towards(id, [stepX, stepY]) {
    const { places } = this.#layout;
    const from = places.get(id);
    let best = id;
    let least = Infinity;
    for (const [other, place] of places) {
      const along = (place.x - from.x) * stepX + (place.y - from.y) * stepY;
      const aside = Math.abs((place.x - from.x) * stepY) + Math.abs((place.y - from.y) * stepX);
      if (along > 1 && along + 2 * aside < least) {
        least = along + 2 * aside;
        best = other;
      }
    }
    return best;
  }
}

function sizeOf(vertex) {
  const name = text.cut(vertex.name, NAME_MAX);
  ruler.font = '600 13px system-ui, sans-serif';
  // The metric has room for the longest usual one, so that boxes keep their size.
  const width = Math.max(ruler.measureText(name).width, 104) + 28;
  return { name, width: Math.ceil(width), height: vertex.kind === 'group' ? 46 : 40 };
}

function metricOf(vertex) {
  switch (vertex.kind) {
    case 'node': {
      const count = (kinds) => vertex.faces.filter((face) => kinds.includes(face.kind)).length;
      const parts = [[['publisher'], 'pub'], [['subscriber'], 'sub'], [['server', 'client'], 'srv']];
      const shown = parts.map(([kinds, name]) => [count(kinds), name]).filter(([number]) => number > 0);
      return shown.map(([number, name]) => `${number} ${name}`).join(' · ') || 'no interfaces';
    }
    case 'group':
      return `${count(vertex.members, 'node')} · ${count(vertex.members, 'topic')}`;
    default:
      return `${text.rate(vertex.rate)} · ${text.bandwidth(vertex.bytes)}`;
  }
}

function count(members, kind) {
  const number = members.filter((it) => it.kind === kind).length;
  return `${number} ${kind}${number === 1 ? '' : 's'}`;
}

function stateOf(edge) {
  if (edge.refused) {
    return 'refused';
  }
  if (edge.links === 0) {
    return 'unlinked';
  }
  return edge.rate || edge.inRate ? 'active' : 'idle';
}

function labelOf(edge) {
  if (edge.refused) {
    return 'refused';
  }
  if (edge.links === 0) {
    return 'not linked';
  }
  if (edge.rate != null) {
    return `${text.rate(edge.rate)} · ${text.bandwidth(edge.bytes)}`;
  }
  if (edge.inRate != null) {
    const rate = text.rate(edge.inRate);
    return edge.delay == null ? rate : `${rate} · ${text.duration(edge.delay / 1e6)}`;
  }
  return '';
}

function lossesOf(edge) {
  const losses = (edge.lost ?? 0) + (edge.dropped ?? 0);
  return losses > 0 ? `−${text.number(losses)}` : '';
}

function titleOf(edge) {
  const names = `${edge.from.slice(2)} → ${edge.to.slice(2)}`;
  return [names, labelOf(edge), lossesOf(edge)].filter(Boolean).join('\n');
}

// From 1.2 to 6 pixels, by the logarithm of the bandwidth.
function widthOf(edge) {
  const bytes = edge.bytes ?? edge.inBytes ?? 0;
  return (1.2 + Math.min(Math.max(Math.log10(bytes + 1) - 2, 0), 6) * 0.7).toFixed(1);
}

function curve(points, isDown) {
  let path = `M${points[0].x} ${points[0].y}`;
  for (let at = 1; at < points.length; at += 1) {
    const [from, to] = [points[at - 1], points[at]];
    const [one, other] = isDown
      ? [{ x: from.x, y: (from.y + to.y) / 2 }, { x: to.x, y: (from.y + to.y) / 2 }]
      : [{ x: (from.x + to.x) / 2, y: from.y }, { x: (from.x + to.x) / 2, y: to.y }];
    path += `C${one.x} ${one.y} ${other.x} ${other.y} ${to.x} ${to.y}`;
  }
  return path;
}

// The head of an arrow, at the end to which the data flows.
function arrow(points, isTurned, isDown) {
  const { x, y } = isTurned ? points[0] : points[points.length - 1];
  const back = isTurned ? 8 : -8;
  return isDown ? `M${x} ${y}l-4 ${back}l8 0z` : `M${x} ${y}l${back} -4l0 8z`;
}

// The place of a label: in the gap beside the topic, since edges meet at nodes. `isLast` says whether the topic is at
// the end of the curve.
function labelPlace(points, isLast, isDown, isTurned) {
  const [from, to] = isLast ? points.slice(-2) : points.slice(0, 2);
  const t = isLast ? 0.62 : 0.38;
  // The curve along the ranks and across them, as the control points of `curve` say.
  const along = (one, other) => one + (other - one) * (1.5 * t * (1 - t) + t ** 3);
  const aside = (one, other) => one + (other - one) * (3 * t ** 2 - 2 * t ** 3);
  if (!isDown) {
    return { x: along(from.x, to.x), y: aside(from.y, to.y) - 5, 'text-anchor': 'middle' };
  }
  // Beside the curve: above it if the curves of a node part here, and below it if they meet.
  const isAbove = isLast && !isTurned;
  const isRight = Math.abs(to.x - from.x) < 1 || (to.x > from.x) === isAbove;
  const x = aside(from.x, to.x) + (isRight ? 7 : -7);
  return { x, y: along(from.y, to.y) + (isAbove ? 2 : 9), 'text-anchor': isRight ? 'start' : 'end' };
}
