// Search runs in a web worker, which browsers refuse to start for pages opened from a folder
// (file://). There, and only there, Worker becomes a hidden iframe that runs the same script.
// The theme looks for the name IFrameWorker, and its offline plugin for this file's name.
if (location.protocol === "file:") {
  class IFrameWorker extends EventTarget {
    #frame = document.createElement("iframe");
    #pending = []; // messages posted before the script has run

    constructor(url) {
      super();
      this.#frame.hidden = true;
      document.body.append(this.#frame);
      const inside = this.#frame.contentWindow;
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      const script = inside.document.createElement("script");
      script.src = url;
      script.onload = () => {
        const waiting = this.#pending;
        this.#pending = null;
        waiting.forEach((data) => this.postMessage(data));
      };
      script.onerror = () => this.dispatchEvent(new ErrorEvent("error", { message: String(url) }));
      inside.document.body.append(script);
    }

    postMessage(data) {
      if (this.#pending) this.#pending.push(data);
      else {
        const inside = this.#frame.contentWindow;
        inside.dispatchEvent(new inside.MessageEvent("message", { data }));
      }
    }

    terminate() {
      this.#frame.remove();
    }
  }
  window.IFrameWorker = window.Worker = IFrameWorker;
}
