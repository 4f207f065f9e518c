// Search in pages that are opened from the disk: browsers start no worker for file:// addresses. The search's worker
// runs in a hidden frame there instead. Pages from a server are not touched.
// The name holds "iframe-worker" so that mkdocs-material's plugin `offline` adds no script of another server.
if (location.protocol === "file:") {
  window.IFrameWorker = window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      const inside = frame.contentWindow
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }))
      const script = inside.document.createElement("script")
      this.loaded = new Promise((resolve) => script.addEventListener("load", resolve))
      script.src = url
      inside.document.body.append(script)
      this.inside = inside
      this.frame = frame
    }

    postMessage(data) {
      this.loaded.then(() => this.inside.dispatchEvent(new this.inside.MessageEvent("message", { data })))
    }

    terminate() {
      this.frame.remove()
    }
  }
}
