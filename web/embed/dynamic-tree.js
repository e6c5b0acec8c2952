// <dynamic-tree src="https://…/embed#…">: a tree that sways and answers a pull, in a frame of its own. See README.md.

const OPTIONS = ["turntable", "theme", "transparent"];
const LOOK = new CSSStyleSheet();
LOOK.replaceSync(`
  :host { display: block; aspect-ratio: 4 / 3; }
  :host([hidden]) { display: none; }
  iframe { display: block; width: 100%; height: 100%; border: 0; color-scheme: light dark; }
  :host([theme="light"]) iframe { color-scheme: light; } /* a frame of another scheme is not transparent */
  :host([theme="dark"]) iframe { color-scheme: dark; }
`);

export class DynamicTree extends HTMLElement {
  static observedAttributes = ["src", "aria-label", ...OPTIONS];

  constructor() {
    super();
    this.frame = document.createElement("iframe");
    this.frame.allow = "fullscreen";
    this.frame.loading = "lazy";
    this.frame.referrerPolicy = "no-referrer";
    const root = this.attachShadow({ mode: "open" });
    root.adoptedStyleSheets = [LOOK];
    root.append(this.frame);
    this.hear = (event) => this._hear(event);
  }

  connectedCallback() {
    addEventListener("message", this.hear);
    this._show();
  }

  disconnectedCallback() {
    removeEventListener("message", this.hear);
  }

  attributeChangedCallback() {
    if (this.isConnected) this._show();
  }

  /** The frame's address: `src`, or the example of the service that this module comes from; and the options. */
  get address() {
    const address = new URL(
      this.getAttribute("src") ?? "/embed",
      this.hasAttribute("src") ? location.href : import.meta.url,
    );
    const fragment = new URLSearchParams(address.hash.slice(1));
    for (const name of OPTIONS) if (this.hasAttribute(name)) fragment.set(name, this.getAttribute(name) || "1");
    address.hash = fragment.toString();
    return address.href;
  }

  _show() {
    this.frame.title = this.getAttribute("aria-label") ?? "A tree that sways in the wind";
    if (this.frame.src !== this.address) this.frame.src = this.address;
  }

  /** `moving` once the tree moves, `failed` with the service's `detail.code` where it cannot. */
  _hear({ source, data }) {
    if (source !== this.frame.contentWindow || data?.type !== "dynamic-tree") return;
    const { state, code } = data;
    this.dataset.state = state;
    this.dispatchEvent(new CustomEvent(state === "moving" ? "moving" : "failed", { detail: { code } }));
  }
}

customElements.define("dynamic-tree", DynamicTree);
