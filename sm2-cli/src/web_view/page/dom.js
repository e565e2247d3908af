// Builds and updates elements. Text always becomes a text node, and attributes are set by name, so nothing that comes
// from the domain is ever parsed as markup.

const SVG = 'http://www.w3.org/2000/svg';
const SVG_TAGS = new Set(['svg', 'g', 'path', 'rect', 'circle', 'text', 'tspan', 'title', 'polyline', 'line']);

// Describes an element. `key` is the identity of an element among its siblings, `on…` are listeners, and `value` false
// or null leaves an attribute out.
export function h(tag, attributes = {}, ...children) {
  return { tag, attributes, children: children.flat(Infinity).filter((child) => child != null && child !== false) };
}

// Makes the children of `parent` those that `descriptions` describes. Elements with the same key and tag are kept, so
// the focus and the selection of text stay.
export function patch(parent, descriptions) {
  const kept = new Map();
  for (const child of parent.childNodes) {
    kept.set(identity(child.described, child.place), child);
  }
  const seen = new Set();
  let at = parent.firstChild;
  [descriptions].flat(Infinity).forEach((description, place) => {
    let id = identity(description, place);
    while (seen.has(id)) {
      id += '+';
    }
    seen.add(id);
    const element = kept.get(id) ?? create(description);
    kept.delete(id);
    element.place = place;
    update(element, description);
    if (element === at) {
      at = at.nextSibling;
    } else {
      parent.insertBefore(element, at);
    }
  });
  for (const child of kept.values()) {
    child.remove();
  }
}

function identity(description, place) {
  if (description === undefined || typeof description !== 'object') {
    return `#text ${place}`;
  }
  return `${description.tag} ${description.attributes.key ?? place}`;
}

function create(description) {
  if (typeof description !== 'object') {
    return document.createTextNode('');
  }
  const { tag } = description;
  return SVG_TAGS.has(tag) ? document.createElementNS(SVG, tag) : document.createElement(tag);
}

function update(element, description) {
  if (typeof description !== 'object') {
    const text = String(description);
    if (element.data !== text) {
      element.data = text;
    }
    return;
  }
  const before = element.described?.attributes ?? {};
  const { attributes, children } = description;
  element.described = description;
  for (const name of new Set([...Object.keys(before), ...Object.keys(attributes)])) {
    const value = attributes[name];
    if (name === 'key' || (value === before[name] && name in before)) {
      continue;
    }
    if (name.startsWith('on')) {
      element[name] = value ?? null;
    } else if (value == null || value === false) {
      element.removeAttribute(name);
    } else {
      element.setAttribute(name, value === true ? '' : value);
    }
  }
  patch(element, children);
}
