// SPDX-License-Identifier: Apache-2.0
// A page opened from the disk may not start workers, which the site's search does. There a hidden
// frame stands in for one: it runs the same script, and messages go to and fro as events.
'use strict'

if (location.protocol === 'file:') {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement('iframe')
      frame.hidden = true
      frame.title = 'search'
      document.body.append(frame)
      this.inside = frame.contentWindow
      this.inside.postMessage = (data) => {
        this.dispatchEvent(new MessageEvent('message', {data}))
      }
      const script = frame.contentDocument.createElement('script')
      script.src = url
      this.loaded = new Promise((resolve) => { script.onload = resolve })
      frame.contentDocument.body.append(script)
    }

    postMessage(data) {
      this.loaded.then(() => {
        this.inside.dispatchEvent(new MessageEvent('message', {data}))
      })
    }

    terminate() {
      this.inside.frameElement.remove()
    }
  }
}
