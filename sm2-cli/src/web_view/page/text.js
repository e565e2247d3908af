// Figures as short texts.

const NONE = '–';

export function rate(hz) {
  return hz == null ? NONE : `${short(hz)} Hz`;
}

export function bandwidth(bytes) {
  return bytes == null ? NONE : `${size(bytes)}/s`;
}

export function size(bytes) {
  for (const unit of ['B', 'kB', 'MB']) {
    if (bytes < 999.5) {
      return `${short(bytes)} ${unit}`;
    }
    bytes /= 1000;
  }
  return `${short(bytes)} GB`;
}

export function duration(ms) {
  if (ms == null) {
    return NONE;
  }
  return ms < 1 ? `${short(ms * 1000)} µs` : ms < 1000 ? `${short(ms)} ms` : `${short(ms / 1000)} s`;
}

export function number(value) {
  return value == null ? NONE : value.toLocaleString('en');
}

// Three significant digits, without an exponent.
function short(value) {
  if (value >= 99.95) {
    return Math.round(value).toLocaleString('en');
  }
  return value >= 9.995 ? value.toFixed(1) : value >= 0.005 ? value.toFixed(2) : '0';
}

// At most `length` characters; the middle is left out.
export function cut(text, length) {
  const half = Math.floor((length - 1) / 2);
  return text.length <= length ? text : `${text.slice(0, half)}…${text.slice(-half)}`;
}
