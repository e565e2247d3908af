// The model of a domain: vertices (nodes, topics and services) and edges (publishers, subscribers, servers, clients),
// with their figures, made anew from each sample.

// How many samples a history keeps: three minutes.
const HISTORY = 180;

const histories = new Map();

export function nodeId(name) {
  return `n:${name}`;
}

function subjectId(face) {
  return `${isService(face) ? 's' : 't'}:${face.name}`;
}

function isService(face) {
  return face.kind === 'server' || face.kind === 'client';
}

// Makes the model of a sample.
export function model(sample) {
  const figures = new Map(sample.figures.map((it) => [`${it.node_id}.${it.interface}`, it]));
  const vertices = new Map();
  const edges = new Map();
  for (const node of sample.domain.nodes) {
    add(vertices, nodeId(node.name), { kind: 'node', name: node.name, node, faces: [], ...zero() });
  }
  for (const face of sample.domain.interfaces) {
    face.figures = figures.get(`${face.node_id}.${face.interface}`);
    const subject = subjectId(face);
    const kind = isService(face) ? 'service' : 'topic';
    add(vertices, subject, { kind, name: face.name, faces: [], ...zero() });
    const node = nodeId(face.node);
    add(vertices, node, { kind: 'node', name: face.node, faces: [], ...zero() });
    vertices.get(node).faces.push(face);
    vertices.get(subject).faces.push(face);
    // Data flows from publishers to topics and subscribers; requests flow from clients to services and servers.
    const isSource = face.kind === 'publisher' || face.kind === 'client';
    const [from, to] = isSource ? [node, subject] : [subject, node];
    const id = `${from} > ${to}`;
    add(edges, id, { from, to, isSource, kind, faces: [], links: 0, refused: null, ...zero() });
    const edge = edges.get(id);
    edge.faces.push(face);
    edge.links += face.links;
    edge.refused ??= face.refused;
    count(edge, face, isSource);
    count(vertices.get(node), face, isSource);
    if (face.kind === 'publisher' || face.kind === 'client') {
      count(vertices.get(subject), face, true);
    } else {
      const it = vertices.get(subject);
      it.lost = sum(it.lost, face.figures?.lost);
      it.delay = max(it.delay, face.figures?.delay_ns);
    }
  }
  for (const link of sample.domain.links) {
    link.id = `link ${link.link}`;
  }
  remember(vertices);
  return { sample, vertices, edges };
}

function zero() {
  return { rate: null, bytes: null, inRate: null, inBytes: null, dropped: null, lost: null, delay: null };
}

function add(map, id, value) {
  if (!map.has(id)) {
    map.set(id, { id, ...value });
  }
}

// Adds the figures of an interface to a vertex or an edge.
function count(it, face, isSource) {
  const of = face.figures;
  if (!of) {
    return;
  }
  if (isSource) {
    it.rate = sum(it.rate, of.out_per_s);
    it.bytes = sum(it.bytes, of.out_bytes_per_s);
    it.dropped = sum(it.dropped, of.dropped);
  } else {
    it.inRate = sum(it.inRate, of.in_per_s);
    it.inBytes = sum(it.inBytes, of.in_bytes_per_s);
    it.lost = sum(it.lost, of.lost);
    it.delay = max(it.delay, of.delay_ns);
  }
}

function sum(one, other) {
  return one == null ? other ?? null : one + (other ?? 0);
}

function max(one, other) {
  return one == null ? other ?? null : Math.max(one, other ?? 0);
}

// Appends the rates of all vertices to their histories, and drops those of vertices that are gone.
function remember(vertices) {
  for (const id of histories.keys()) {
    if (!vertices.has(id)) {
      histories.delete(id);
    }
  }
  for (const vertex of vertices.values()) {
    const history = histories.get(vertex.id) ?? [];
    history.push({ rate: vertex.rate ?? vertex.inRate, bytes: vertex.bytes ?? vertex.inBytes });
    if (history.length > HISTORY) {
      history.shift();
    }
    histories.set(vertex.id, history);
  }
}

// The last values of a figure of a vertex, oldest first.
export function history(id, figure) {
  return (histories.get(id) ?? []).map((it) => it[figure]);
}

// The first segment of a name that has several, or null. The nodes `remote/…` stand for other domains.
export function groupOf(name) {
  const at = name.indexOf('/');
  return at < 0 || name.startsWith('remote/') ? null : name.slice(0, at);
}

export function isPeer(name) {
  return name.startsWith('remote/');
}

// The graph to draw: the model with collapsed groups as single vertices, and only what fits the filter.
// `isCollapsed` decides for each group; `filter` is a lower-case text.
export function graph(domain, isCollapsed, filter) {
  const shown = new Set();
  for (const vertex of domain.vertices.values()) {
    if (!filter || vertex.name.toLowerCase().includes(filter)) {
      shown.add(vertex.id);
    }
  }
  if (filter) {
    // The counterparts of what fits are shown, too.
    for (const edge of domain.edges.values()) {
      const [from, to] = [domain.vertices.get(edge.from), domain.vertices.get(edge.to)];
      const fits = (it) => it.name.toLowerCase().includes(filter);
      if (fits(from) || fits(to)) {
        shown.add(from.id).add(to.id);
      }
    }
  }
  const vertices = new Map();
  const place = new Map();
  for (const id of [...shown].sort()) {
    const vertex = domain.vertices.get(id);
    const group = groupOf(vertex.name);
    if (group !== null && isCollapsed(group)) {
      const of = `g:${group}`;
      add(vertices, of, { kind: 'group', name: group, members: [], ...zero() });
      vertices.get(of).members.push(vertex);
      place.set(id, of);
    } else {
      vertices.set(id, vertex);
      place.set(id, id);
    }
  }
  const edges = new Map();
  for (const edge of domain.edges.values()) {
    const [from, to] = [place.get(edge.from), place.get(edge.to)];
    if (from === undefined || to === undefined || from === to) {
      continue;
    }
    const id = `${from} > ${to}`;
    if (from === edge.from && to === edge.to) {
      edges.set(id, edge);
      continue;
    }
    add(edges, id, { ...edge, id, from, to, faces: [], links: 0, parts: 0, refused: null, ...zero() });
    const joint = edges.get(id);
    joint.parts += 1;
    joint.links += edge.links;
    joint.refused ??= edge.refused;
    joint.faces.push(...edge.faces);
    for (const figure of ['rate', 'bytes', 'inRate', 'inBytes', 'dropped', 'lost']) {
      joint[figure] = sum(joint[figure], edge[figure]);
    }
    joint.delay = max(joint.delay, edge.delay);
  }
  return { vertices, edges };
}

// The groups of a model with the number of their members.
export function groups(domain) {
  const counts = new Map();
  for (const { name } of domain.vertices.values()) {
    const group = groupOf(name);
    if (group !== null) {
      counts.set(group, (counts.get(group) ?? 0) + 1);
    }
  }
  return counts;
}
