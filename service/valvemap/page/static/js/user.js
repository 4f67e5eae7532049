// Who is logged in, and what may be done in that name.

class User extends EventTarget {
  name = null;
  mayLogIn = false;
  hasRig = false;
  #dialog = document.querySelector("dialog.log-in");
  #button = document.querySelector("button.user");

  constructor() {
    super();
    const form = this.#dialog.querySelector("form"), problem = form.querySelector(".problem");
    this.#button.addEventListener("click", () => (this.name ? this.#logOut() : this.ask()));
    form.querySelector(".cancel").addEventListener("click", () => this.#dialog.close());
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      problem.textContent = "";
      const { user, password } = Object.fromEntries(new FormData(form));
      const answer = await post("log-in", { user, password });
      form.elements.password.value = "";
      if (answer.error) { problem.textContent = answer.error; return; }
      this.#dialog.close();
      this.#take({ ...answer });
    });
    this.refresh();
  }

  ask() {
    if (!this.mayLogIn) { alert("Nobody can log in here: the page is open to the network without https."); return; }
    this.#dialog.showModal();
  }

  async refresh() {
    try { this.#take(await (await fetch("user")).json()); } catch { /* the link says what is wrong */ }
  }

  /** Carry out a command; returns an error's text, or null. */
  async command(command) {
    const answer = await post("command", command);
    if (answer.status === 401) this.#take({ user: null });
    return answer.error ?? null;
  }

  async #logOut() { this.#take(await post("log-out", {})); }

  #take({ user = null, mayLogIn = this.mayLogIn, hasRig = this.hasRig }) {
    Object.assign(this, { name: user, mayLogIn, hasRig });
    this.#button.textContent = user ? `${user} · log out` : "Log in";
    this.dispatchEvent(new Event("change"));
  }
}

async function post(path, body) {
  try {
    const response = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
    return { status: response.status, ...(await response.json().catch(() => ({ error: `refused (${response.status})` }))) };
  } catch {
    return { error: "the page's server does not answer" };
  }
}

export const user = new User();
