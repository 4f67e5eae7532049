// Questions whose answers may come too late: when the view is closed, or something newer was asked. Pure.

/**
 * What a view asks with: `await ask(about, answer)` is the answer, or undefined where it is of no use any more, because the view
 * was closed or something newer was asked about the same. `ask.within()` is for a part of the view that ends earlier.
 */
export function asker(around = { isOpen: () => true }) {
  const newest = new Map();
  let isClosed = false;

  async function ask(about, answer) {
    const asked = {};
    newest.set(about, asked);
    const found = await answer, isNewest = newest.get(about) === asked;
    if (isNewest) newest.delete(about);
    return isNewest && ask.isOpen() ? found : undefined;
  }
  ask.isOpen = () => !isClosed && around.isOpen();
  ask.close = () => { isClosed = true; };
  ask.within = () => asker(ask);
  return ask;
}
