// Values that several parts of the page share.
import { useEffect, useState } from "./html.js";

/**
 * Hold a value that parts of the page subscribe to.
 * @template T
 * @param {T} initial
 */
export function createStore(initial) {
  let value = initial;
  const listeners = new Set();
  return {
    get: () => value,
    /** @param {Partial<T> | ((value: T) => Partial<T>)} change */
    set(change) {
      const part = typeof change === "function" ? change(value) : change;
      if (Object.entries(part).every(([name, one]) => value[name] === one)) return;
      value = { ...value, ...part };
      for (const listener of [...listeners]) listener();
    },
    subscribe(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
  };
}

/** Draw a component again whenever the selected part of a store changes. */
export function useStore(store, select = (value) => value) {
  const [part, setPart] = useState(() => select(store.get()));
  useEffect(() => {
    const update = () => setPart(() => select(store.get()));
    update();
    return store.subscribe(update);
  }, [store]);
  return part;
}
