// A layered layout: data flows from left to right, or from top to bottom. The result depends only on the names and the
// edges, so it stays as it is until the structure changes.
//
// 1. Each connected component is laid out alone; components are packed in rows.
// 2. A depth-first search in the order of names finds edges that close cycles, and turns them round.
// 3. The longest path decides the rank (column) of a vertex; vertices without input move next to their successor.
// 4. Long edges get a bend in each rank that they cross.
// 5. Sweeps order each rank by the mean place of neighbours, which removes most crossings.
// 6. A rank with many vertices becomes a grid. Each other rank is moved towards the mean height of
//    neighbours, with a least-squares fit that keeps order and distance.

// Between two ranks there is room for labels; `across` is the gap between vertices of a rank.
const GAPS = { across: { rank: 120, across: 18 }, down: { rank: 64, across: 30 } };
const BEND = 10;
const SWEEPS = 8;
// A rank with more vertices than this becomes a grid.
const RANK_MAX = 20;

// `vertices`: a map from ids to `{ width, height }`; `edges`: a list of `{ id, from, to }`. Returns `{ places, routes,
// width, height, isDown }`: the centre of each vertex, and for each edge its points in the order of ranks.
//
// The direction is the one in which the graph fills an area of `aspect` (width by height) better.
export function layout(vertices, edges, aspect) {
  const [right, down] = [false, true].map((isDown) => directed(vertices, edges, aspect, isDown));
  const size = (it) => Math.max(it.width, it.height * aspect);
  return size(down) * 1.1 < size(right) ? down : right;
}

// The layout for one direction. The steps below know only the direction to the right.
function directed(vertices, edges, aspect, isDown) {
  const gaps = isDown ? GAPS.down : GAPS.across;
  const shape = isDown ? 1 / aspect : aspect;
  const sizes = isDown ? new Map([...vertices].map(([id, size]) => [id, turned(size)])) : vertices;
  const parts = components(sizes, edges).map((part) => layer(part, gaps, shape));
  const result = pack(parts, gaps, shape);
  if (!isDown) {
    return { ...result, isDown };
  }
  const turn = ({ x, y }) => ({ x: y, y: x });
  const places = new Map([...result.places].map(([id, place]) => [id, turn(place)]));
  const routes = new Map([...result.routes].map(([id, route]) => [id, { ...route, points: route.points.map(turn) }]));
  return { places, routes, ...turned(result), isDown };
}

function turned({ width, height }) {
  return { width: height, height: width };
}

function components(vertices, edges) {
  const near = new Map([...vertices.keys()].sort().map((id) => [id, []]));
  for (const edge of edges) {
    near.get(edge.from).push(edge.to);
    near.get(edge.to).push(edge.from);
  }
  const part = new Map();
  const parts = [];
  for (const start of near.keys()) {
    if (part.has(start)) {
      continue;
    }
    const it = { ids: [], sizes: vertices, edges: [] };
    const queue = [start];
    part.set(start, it);
    while (queue.length > 0) {
      const id = queue.pop();
      it.ids.push(id);
      for (const next of near.get(id).filter((next) => !part.has(next))) {
        part.set(next, it);
        queue.push(next);
      }
    }
    it.ids.sort();
    parts.push(it);
  }
  for (const edge of edges) {
    part.get(edge.from).edges.push(edge);
  }
  return parts;
}

function layer({ ids, sizes, edges }, gaps, aspect) {
  const forward = withoutCycles(ids, edges);
  const ranks = rank(ids, forward);
  const items = new Map(ids.map((id) => [id, { ...sizes.get(id), id, before: [], after: [], y: 0 }]));
  const columns = [];
  const put = (item, at) => {
    (columns[at] ??= []).push(item);
    item.rank = at;
  };
  ids.forEach((id) => put(items.get(id), ranks.get(id)));
  const chains = forward.map(({ edge, from, to }) => {
    const chain = [items.get(from)];
    for (let at = ranks.get(from) + 1; at < ranks.get(to); at += 1) {
      const bend = { width: 0, height: BEND, before: [], after: [], y: 0 };
      put(bend, at);
      chain.push(bend);
    }
    chain.push(items.get(to));
    for (let at = 1; at < chain.length; at += 1) {
      chain[at - 1].after.push(chain[at]);
      chain[at].before.push(chain[at - 1]);
    }
    return { edge, chain };
  });
  order(columns);
  const crowded = columns.map(withoutBends).filter((all) => all.length > RANK_MAX).length;
  columns.forEach((column) => fold(column, gaps.across, aspect / crowded));
  const width = across(columns, gaps);
  down(columns, gaps.across);
  return finish(items, columns, chains, width);
}

// The edges, each from the lower to the higher rank.
function withoutCycles(ids, edges) {
  const out = new Map(ids.map((id) => [id, []]));
  const inputs = new Map(ids.map((id) => [id, 0]));
  for (const edge of edges) {
    out.get(edge.from).push(edge);
    inputs.set(edge.to, inputs.get(edge.to) + 1);
  }
  const state = new Map();
  const result = [];
  const visit = (start) => {
    const stack = [[start, 0]];
    state.set(start, 'open');
    while (stack.length > 0) {
      const top = stack[stack.length - 1];
      const edge = out.get(top[0])[top[1]];
      top[1] += 1;
      if (edge === undefined) {
        state.set(top[0], 'done');
        stack.pop();
      } else if (state.get(edge.to) === 'open') {
        result.push({ edge, from: edge.to, to: edge.from });
      } else {
        result.push({ edge, from: edge.from, to: edge.to });
        if (!state.has(edge.to)) {
          state.set(edge.to, 'open');
          stack.push([edge.to, 0]);
        }
      }
    }
  };
  const sources = ids.filter((id) => inputs.get(id) === 0);
  for (const id of [...sources, ...ids]) {
    if (!state.has(id)) {
      visit(id);
    }
  }
  return result;
}

function rank(ids, forward) {
  const out = new Map(ids.map((id) => [id, []]));
  const waits = new Map(ids.map((id) => [id, 0]));
  for (const { from, to } of forward) {
    out.get(from).push(to);
    waits.set(to, waits.get(to) + 1);
  }
  const ranks = new Map(ids.map((id) => [id, 0]));
  const sources = ids.filter((id) => waits.get(id) === 0);
  const ready = [...sources];
  while (ready.length > 0) {
    const id = ready.shift();
    for (const to of out.get(id)) {
      ranks.set(to, Math.max(ranks.get(to), ranks.get(id) + 1));
      waits.set(to, waits.get(to) - 1);
      if (waits.get(to) === 0) {
        ready.push(to);
      }
    }
  }
  for (const id of sources.filter((id) => out.get(id).length > 0)) {
    ranks.set(id, Math.min(...out.get(id).map((to) => ranks.get(to))) - 1);
  }
  return ranks;
}

function order(columns) {
  const number = (column) => column.forEach((item, at) => { item.at = at; });
  columns.forEach(number);
  const sort = (column, side) => {
    for (const item of column) {
      const near = item[side];
      item.mean = near.length === 0 ? item.at : near.reduce((sum, it) => sum + it.at, 0) / near.length;
    }
    column.sort((one, other) => one.mean - other.mean || one.at - other.at);
    number(column);
  };
  for (let sweep = 0; sweep < SWEEPS; sweep += 1) {
    columns.slice(1).forEach((column) => sort(column, 'before'));
    columns.slice(0, -1).reverse().forEach((column) => sort(column, 'after'));
  }
}

// Gives each item of a large column its row and its place in the row, so that the column fills an area of `aspect`.
function fold(column, gap, aspect) {
  const real = withoutBends(column);
  if (real.length <= RANK_MAX) {
    return;
  }
  const [width, height] = ['width', 'height'].map((side) => Math.max(...real.map((item) => item[side])) + gap);
  const length = Math.max(Math.round(Math.sqrt(real.length * height * aspect / width)), 1);
  const rows = Math.ceil(real.length / length);
  real.forEach((item, at) => {
    const row = Math.floor(at / length);
    item.cell = { x: (at % length) * width, y: (row - (rows - 1) / 2) * height };
  });
  column.width = length * width - gap;
}

// The items of a column without bends.
function withoutBends(column) {
  return column.filter((item) => item.width > 0);
}

// Sets the x of all items. Returns the width.
function across(columns, gaps) {
  let x = 0;
  for (const column of columns) {
    const width = column.width ?? Math.max(...column.map((item) => item.width));
    for (const item of column) {
      item.x = item.cell ? x + item.cell.x + item.width / 2 : x + width / 2;
    }
    x += width + gaps.rank;
  }
  return x - gaps.rank;
}

// Sets the y of all items.
function down(columns, gap) {
  for (const column of columns) {
    fit(column, column.map(() => 0), gap);
  }
  for (let sweep = 0; sweep < SWEEPS; sweep += 1) {
    const sides = sweep % 2 === 0 ? ['before', 'after'] : ['after', 'before'];
    const sequence = sweep % 2 === 0 ? columns : [...columns].reverse();
    for (const column of sequence) {
      fit(column, column.map((item) => {
        const near = sweep < SWEEPS - 2 && item[sides[0]].length > 0 ? item[sides[0]] : [...item.before, ...item.after];
        return near.length === 0 ? item.y : near.reduce((sum, it) => sum + it.y, 0) / near.length;
      }), gap);
    }
  }
}

// Moves the items of a column as near to `wanted` as their order and distance allow (pool adjacent violators).
function fit(column, wanted, gap) {
  if (column.width !== undefined) {
    const centre = wanted.reduce((sum, y) => sum + y, 0) / wanted.length;
    column.forEach((item, at) => { item.y = item.cell ? centre + item.cell.y : wanted[at]; });
    return;
  }
  const pools = [];
  let offset = 0;
  column.forEach((item, at) => {
    if (at > 0) {
      offset += (column[at - 1].height + item.height) / 2 + gap;
    }
    item.offset = offset;
    pools.push({ sum: wanted[at] - offset, count: 1 });
    while (pools.length > 1 && mean(pools[pools.length - 2]) > mean(pools[pools.length - 1])) {
      const last = pools.pop();
      const pool = pools[pools.length - 1];
      pool.sum += last.sum;
      pool.count += last.count;
    }
  });
  let at = 0;
  for (const pool of pools) {
    for (let left = pool.count; left > 0; left -= 1) {
      column[at].y = column[at].offset + mean(pool);
      at += 1;
    }
  }
}

function mean(pool) {
  return pool.sum / pool.count;
}

function finish(items, columns, chains, width) {
  const all = columns.flat();
  const top = Math.min(...all.map((item) => item.y - item.height / 2));
  const bottom = Math.max(...all.map((item) => item.y + item.height / 2));
  const places = new Map();
  for (const item of items.values()) {
    places.set(item.id, { x: item.x, y: item.y - top });
  }
  const routes = new Map();
  for (const { edge, chain } of chains) {
    const points = chain.map((item, at) => {
      const side = at === 0 ? item.width / 2 : at === chain.length - 1 ? -item.width / 2 : 0;
      return { x: item.x + side, y: item.y - top };
    });
    routes.set(edge.id, { points, isTurned: edge.from !== chain[0].id });
  }
  return { places, routes, width, height: bottom - top };
}

// Puts components in rows, the largest first.
function pack(parts, gaps, aspect) {
  const gap = 2 * gaps.across;
  const area = parts.reduce((sum, part) => sum + (part.width + gap) * (part.height + gap), 0);
  const limit = Math.max(...parts.map((part) => part.width), Math.sqrt(area * aspect));
  const result = { places: new Map(), routes: new Map(), width: 0, height: 0 };
  const row = { x: 0, y: 0, height: 0 };
  for (const part of [...parts].sort((one, other) => other.height - one.height)) {
    if (row.x > 0 && row.x + part.width > limit) {
      Object.assign(row, { x: 0, y: row.y + row.height + gap, height: 0 });
    }
    const move = ({ x, y }) => ({ x: x + row.x, y: y + row.y });
    part.places.forEach((place, id) => result.places.set(id, move(place)));
    part.routes.forEach((route, id) => result.routes.set(id, { ...route, points: route.points.map(move) }));
    result.width = Math.max(result.width, row.x + part.width);
    result.height = Math.max(result.height, row.y + part.height);
    row.x += part.width + gap;
    row.height = Math.max(row.height, part.height);
  }
  return result;
}
