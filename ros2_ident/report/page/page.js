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
  // stretch. It breaks where a sample is later than a view's `late`.
  refill(full, views, range, tick) {
    const time = full.time
    const first = Math.max(0, this.rowAt(time, range.start / tick) - 1)
    const last = Math.min(time.length, this.rowAt(time, range.end / tick) + 1)
    const step = Math.max(1, Math.ceil((last - first) / this.COLUMNS))
    for (const view of views) {
      const codes = full[view.column]
      const minus = view.minus ? full[view.minus] : null
      const at = (row) => codes[row] - (minus ? minus[row] : 0)
      const x = [], y = []
      let least = -1, most = -1, begin = first, before = NaN
      const put = () => {
        for (const row of new Set([Math.min(least, most), Math.max(least, most)])) {
          if (row < 0) continue
          x.push(time[row] * tick)
          y.push(view.offset + view.step * at(row))
        }
        least = most = -1
      }
      for (let row = first; row < last; row++) {
        if (codes[row] === this.NOTHING || (minus && minus[row] === this.NOTHING)) continue
        const late = time[row] - before > view.late
        if (late || row >= begin + step) {
          put()
          begin = row
        }
        if (late) { x.push(NaN); y.push(NaN) }
        if (least < 0 || at(row) < at(least)) least = row
        if (most < 0 || at(row) > at(most)) most = row
        before = time[row]
      }
      put()
      view.source.data = {x, y}
    }
  },

  // Bokeh's document of each plot, by the plot's name.
  documents: {},

  models(name, type) {
    const all = [...this.documents[name]._all_models.values()]
    return all.filter((model) => model.type === type)
  },

  // Fills the curves of a plot over time; those behind a tab once more when they are shown.
  fill(name) {
    for (const callback of this.models(name, 'CustomJS')) {
      if (callback.name === 'refill') callback.execute(callback)
    }
  },

  // What the buttons above a plot do with their values.
  actions: {
    // Shows a drive's plots in place of another's.
    drive(name, value) {
      for (const figure of identPage.models(name, 'Figure')) {
        figure.visible = figure.name === `drive-${value}`
      }
      identPage.fill(name)
    },
    // Shows the curves of one simulation, or of all.
    model(name, value) {
      for (const curve of identPage.models(name, 'GlyphRenderer')) {
        if (curve.name?.startsWith('model-')) {
          curve.visible = value === '' || curve.name === `model-${value}`
        }
      }
    },
  },

  press(button) {
    const {plot, do: action, value} = button.dataset
    if (action === 'copy') {
      const text = button.parentNode.querySelector('code').textContent
      navigator.clipboard?.writeText(text).then(() => {
        button.textContent = 'Copied'
        setTimeout(() => { button.textContent = 'Copy' }, 1500)
      })
      return
    }
    if (!this.documents[plot]) return
    this.actions[action](plot, value)
    for (const other of button.parentNode.querySelectorAll('button')) {
      other.setAttribute('aria-pressed', String(other === button))
    }
  },

  // Marks the section in view in the contents.
  watch() {
    const links = new Map([...document.querySelectorAll('nav a')].map(
      (link) => [link.hash.slice(1), link]))
    const seen = new Set()
    const observer = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        if (entry.isIntersecting) seen.add(entry.target.id)
        else seen.delete(entry.target.id)
      }
      const [first] = [...links.keys()].filter((id) => seen.has(id))
      for (const [id, link] of links) {
        if (id === first) link.setAttribute('aria-current', 'true')
        else link.removeAttribute('aria-current')
      }
    }, {rootMargin: '-60px 0px -60% 0px'})
    for (const section of document.querySelectorAll('section')) observer.observe(section)
  },

  async painted() {
    await new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve, 0)))
    if (!performance.getEntriesByName('first picture').length) performance.mark('first picture')
  },

  // Draws the plots one after another, and says when; other pictures are there already.
  async draw() {
    if (document.querySelector('svg.chart')) await this.painted()
    // It warns of plots behind a tab, whose axes are set once they are shown.
    window.Bokeh?.set_log_level('error')
    for (const script of document.querySelectorAll('script.plot')) {
      const item = JSON.parse(script.textContent)
      await Bokeh.embed.embed_item(item)
      this.documents[item.target_id] = Bokeh.documents.at(-1)
      this.fill(item.target_id)
      await new Promise((resolve) => setTimeout(resolve, 0))
      await this.painted()
    }
    performance.mark('all pictures')
    document.documentElement.dataset.ready = 'yes'
  },
}

document.addEventListener('click', (event) => {
  const button = event.target.closest?.('button[data-do]')
  if (button) identPage.press(button)
})
document.addEventListener('DOMContentLoaded', () => {
  identPage.watch()
  // A live page is reloaded once it is drawn, however long a busy computer takes for that.
  identPage.draw().finally(() => {
    const seconds = Number(document.body.dataset.reload ?? 0)
    if (seconds) setTimeout(() => location.reload(), 1000 * seconds)
  })
})
