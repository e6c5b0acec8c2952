// What this browser remembers for the page. In a frame of another site it may refuse to: then nothing is remembered.

export function stored(name) {
  try {
    return localStorage.getItem(name);
  } catch {
    return null;
  }
}

export function store(name, value) {
  try {
    localStorage.setItem(name, value);
  } catch {
    // the choice holds until the page is left
  }
}
