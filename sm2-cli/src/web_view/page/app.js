// The page of `sm2 view`: takes samples from the server, and shows them.

import { h, patch } from './dom.js';
import { graph, groups, model } from './domain.js';
import { Graph } from './graph.js';
import { panel } from './panel.js';
import { table } from './tables.js';

// With more vertices than this, groups are collapsed at first.
const COLLAPSE_FROM = 60;
// A group with fewer members is not collapsed by itself.
const MEMBERS_MIN = 3;
// The pause before the next attempt to reach a server that has refused.
const RETRY_MS = 2000;

const TABS = { graph: 'Graph', topics: 'Topics', nodes: 'Nodes' };

const byId = (id) => document.getElementById(id);

const state = {
  domain: null,
  // Whether the server answers.
  isServed: false,
  tab: 'graph',
  selected: null,
  filter: '',
  sort: { column: 0, isDown: false },
  // Groups that the person has collapsed or expanded.
  collapsed: new Map(),
  // Lines of text, by question.
  answers: new Map(),
};

const picture = new Graph(byId('stage'), select);

function select(id) {
  if (id?.startsWith('g:')) {
    state.collapsed.set(id.slice(2), false);
    id = null;
  }
  state.selected = id;
  show();
}

function show() {
  status();
  controls();
  const { domain, selected } = state;
  if (domain === null) {
    return;
  }
  if (state.tab === 'graph') {
    picture.show(graph(domain, isCollapsed, state.filter), selected);
  } else {
    patch(byId('stage'), table(state.tab, domain, state, { select, sortBy }));
  }
  const actions = { select, collapse, why, schema, gateways };
  patch(byId('panel'), panel(domain, selected, state.answers, actions).filter(Boolean));
}

function isCollapsed(group) {
  const isLarge = state.domain.vertices.size > COLLAPSE_FROM && state.filter === '';
  return state.collapsed.get(group) ?? (isLarge && groups(state.domain).get(group) >= MEMBERS_MIN);
}

function collapse(group) {
  state.collapsed.set(group, true);
  select(null);
}

function sortBy(column) {
  const { sort } = state;
  // Numbers are sorted from the largest one, names from the first one.
  state.sort = { column, isDown: sort.column === column ? !sort.isDown : column > 0 };
  show();
}

function status() {
  const { domain, isServed } = state;
  let [tone, line] = ['warn', 'Connecting …'];
  if (!isServed && domain !== null) {
    [tone, line] = ['bad', 'sm2 view does not answer. This is the last known state'];
  } else if (domain !== null && !domain.sample.connected) {
    [tone, line] = ['warn', 'No Manager: links go on. This is the last known state, until its successor comes'];
  } else if (domain !== null) {
    const { nodes, interfaces, links } = domain.sample.domain;
    [tone, line] = ['ok', `${nodes.length} nodes · ${interfaces.length} interfaces · ${links.length} links`];
  }
  const element = byId('status');
  element.className = tone;
  patch(element, line);
}

function controls() {
  patch(byId('tabs'), Object.entries(TABS).map(([tab, title]) => h('button', {
    key: tab, type: 'button', 'aria-pressed': String(tab === state.tab), onclick: () => open(tab),
  }, title)));
  const all = state.domain === null ? [] : [...groups(state.domain).keys()];
  const isGraph = state.tab === 'graph';
  const isOpen = isGraph && all.some((group) => !isCollapsed(group));
  patch(byId('tools'), [
    isGraph && all.length > 0 && tool(isOpen ? 'Collapse' : 'Expand', 'Collapse or expand all groups of names', () => {
      all.forEach((group) => state.collapsed.set(group, isOpen));
      show();
    }),
    isGraph && tool('+', 'Zoom in', () => picture.zoom(1.25)),
    isGraph && tool('−', 'Zoom out', () => picture.zoom(0.8)),
    isGraph && tool('Fit', 'Show the whole graph', () => picture.fit()),
  ].filter(Boolean));
}

function tool(text, title, onclick) {
  return h('button', { key: title, type: 'button', title, 'aria-label': title, onclick }, text);
}

function open(tab) {
  state.tab = tab;
  state.sort = { column: 0, isDown: false };
  show();
}

// Asks why two interfaces are linked or not; without `other`, for the nearest counterparts of `one`.
function why(question, one, other) {
  // Names have no characters that need an encoding.
  ask(question, other ? `api/why?one=${one}&other=${other}` : `api/why?one=${one}`);
}

// Asks for the types of a topic or service.
function schema(name) {
  ask(`schema ${name}`, `api/schema?name=${name}`);
}

function gateways() {
  ask('gateways', 'api/gateways');
}

// The server answers with a list of lines, or with an error as text.
async function ask(question, path) {
  state.answers.set(question, ['…']);
  show();
  let lines;
  try {
    const response = await fetch(path);
    lines = response.ok ? await response.json() : [await response.text()];
  } catch (error) {
    lines = [`sm2 view does not answer: ${error.message}`];
  }
  state.answers.set(question, lines);
  show();
}

function connect() {
  const events = new EventSource('api/events');
  events.onmessage = (event) => {
    state.isServed = true;
    state.domain = model(JSON.parse(event.data));
    show();
  };
  events.onerror = () => {
    state.isServed = false;
    show();
    // The browser gives up after a refusal, and else tries again by itself.
    if (events.readyState === EventSource.CLOSED) {
      setTimeout(connect, RETRY_MS);
    }
  };
}

byId('filter').addEventListener('input', (event) => {
  state.filter = event.target.value.trim().toLowerCase();
  show();
});

document.addEventListener('keydown', (event) => {
  if (event.key === '/' && event.target !== byId('filter')) {
    event.preventDefault();
    byId('filter').focus();
  } else if (event.key === 'Escape') {
    select(null);
  }
});

show();
connect();
