// SPDX-License-Identifier: Apache-2.0
'use strict'

const identPage = {
  // Twice so many points a curve are drawn at most: about one pair for each column of pixels.
  COLUMNS: 1000,
  NOTHING: -32768,

  // First row whose time is not before a moment.
  rowAt(time, moment) {
    let low = 0, high = time.length
    while (low < high) {
      const middle = (low + high) >> 1
      if (time[middle] < moment) low = middle + 1
      else high = middle
    }
    return low
  },

  // Fills each curve with what is in view: all samples, or the least and the largest of each
  // stretch. `bounds` are the rows at which recordings end; curves break there.
  refill(full, views, bounds, range, tick) {
    const time = full.time
    const first = Math.max(0, this.rowAt(time, range.start / tick) - 1)
    const last = Math.min(time.length, this.rowAt(time, range.end / tick) + 1)
    const step = Math.max(1, Math.ceil((last - first) / this.COLUMNS))
    for (const view of views) {
      const codes = full[view.column]
      const minus = view.minus ? full[view.minus] : null
      const x = [], y = []
      const put = (row) => {
        x.push(time[row] * tick)
        y.push(view.offset + view.step * (codes[row] - (minus ? minus[row] : 0)))
      }
      let begin = first
      for (const bound of bounds) {
        const end = Math.min(bound, last)
        if (end <= begin) continue
        if (x.length) { x.push(NaN); y.push(NaN) }
        for (let start = begin; start < end; start += step) {
          let least = -1, most = -1, low = Infinity, high = -Infinity
          for (let row = start; row < Math.min(start + step, end); row++) {
            if (codes[row] === this.NOTHING || (minus && minus[row] === this.NOTHING)) continue
            const value = codes[row] - (minus ? minus[row] : 0)
            if (value < low) { low = value; least = row }
            if (value > high) { high = value; most = row }
          }
          if (least < 0) continue
          put(Math.min(least, most))
          if (least !== most) put(Math.max(least, most))
        }
        begin = end
      }
      view.source.data = {x, y}
    }
  },

  // Draws the plots one after another, the first at once, and says when.
  async draw() {
    for (const script of document.querySelectorAll('script.plot')) {
      const item = JSON.parse(script.textContent)
      await Bokeh.embed.embed_item(item)
      await new Promise((resolve) => setTimeout(resolve, 0))
      if (!performance.getEntriesByName('first picture').length) {
        await new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve, 0)))
        performance.mark('first picture')
      }
    }
    performance.mark('all pictures')
    document.documentElement.dataset.ready = 'yes'
  },
}

document.addEventListener('DOMContentLoaded', () => identPage.draw())
