// A page that is opened from disk may not start workers: the search then runs in a hidden frame instead.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      this.inside = frame.contentWindow;
      this.ready = new Promise((done) => {
        window.addEventListener("message", (event) => {
          if (event.source !== this.inside) return;
          if (event.data === "the worker is here") done();
          else this.dispatchEvent(new MessageEvent("message", { data: event.data }));
        });
      });
      const loads = `(...urls) => urls.reduce((last, url) => last.then(() => new Promise((done) => {
        const script = document.createElement("script");
        script.src = url;
        script.onload = done;
        document.body.append(script);
      })), Promise.resolve())`;
      this.inside.document.open();
      this.inside.document.write(`<body><script>
        window.postMessage = (message) => parent.postMessage(message, "*");
        window.importScripts = ${loads};
        importScripts(${JSON.stringify(String(url))}).then(() => postMessage("the worker is here"));
      <\/script>`);
      this.inside.document.close();
    }

    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })));
    }

    terminate() {}
  };
}
