// SPDX-License-Identifier: Apache-2.0
'use strict'

const identPage = {
  // Twice so many points a curve are drawn at most: about one pair for each column of pixels.
  COLUMNS: 1000,
  NOTHING: -32768,
  // Colours as in render.py, and those of axes and grid.
  INK: '#1c2733', BLUE: '#0072B2', GREY: '#666666', LINE: '#9aa5b1', GRID: '#e6eaee',
  FONT: 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif',

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

  // The samples of plots over time: times in four bytes each, then the other columns in two.
  async unpacked({packed, rows, columns}) {
    const bytes = Uint8Array.from(atob(packed), (sign) => sign.charCodeAt(0))
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'))
    const buffer = await new Response(stream).arrayBuffer()
    const full = {time: new Int32Array(buffer, 0, rows)}
    columns.forEach((name, k) => {
      full[name] = new Int16Array(buffer, (4 + 2 * k) * rows, rows)
    })
    return full
  },

  // Bokeh's model of one plot, and its tools; what fills its curves is added to the views.
  figure(made, parts, range, cursor, views) {
    const M = Bokeh.require('models/index')
    const figure = new M.Figure({
      name: made.name, height: made.height, visible: made.visible, output_backend: 'svg',
      x_range: range, y_range: new M.DataRange1d({only_visible: true}), min_border: 4,
      min_border_left: 76, background_fill_color: null, border_fill_color: null,
      outline_line_color: null, toolbar_location: null, sizing_mode: 'stretch_width',
      // the library's ring of a plot that has the focus is faint, and dotted
      stylesheets: [`.bk-Canvas { --outline-width: 3px; --outline-style: solid;
        --highlight-color: ${this.BLUE} }`],
    })
    const look = {
      axis_label_text_font: this.FONT, axis_label_text_font_style: 'normal',
      axis_label_text_font_size: '13px', axis_label_text_color: this.INK, axis_label_standoff: 6,
      axis_line_color: this.LINE, major_label_text_font: this.FONT,
      major_label_text_font_size: '13px', major_label_text_color: this.INK,
      major_tick_line_color: this.LINE, major_tick_in: 0, minor_tick_line_color: null,
    }
    const below = new M.LinearAxis({
      ...look, axis_label: made.below ?? '', visible: made.below !== undefined})
    const left = new M.LinearAxis({
      ...look,
      // a text alone could be markup: names may hold $$
      axis_label: new M.PlainText({text: made.label}),
      ticker: new M.BasicTicker({desired_num_ticks: made.ticks}),
    })
    figure.add_layout(below, 'below')
    figure.add_layout(left, 'left')
    for (const [dimension, axis] of [below, left].entries()) {
      figure.add_layout(new M.Grid({axis, dimension, grid_line_color: this.GRID}))
    }
    const across = (glyph, values) => figure.add_glyph(
      glyph, new M.ColumnDataSource({data: {at: values}}))
    if (parts.length) across(new M.VSpan({x: {field: 'at'}, line_color: this.GREY}), parts)
    if (made.floor) {
      const dashed = {y: {field: 'at'}, line_color: this.GREY, line_dash: [6]}
      across(new M.HSpan(dashed), [-made.floor, made.floor])
    }
    for (const curve of made.curves) {
      const source = new M.ColumnDataSource({data: {x: [], y: []}})
      const line = new M.Line({
        x: {field: 'x'}, y: {field: 'y'}, line_color: curve.colour, line_width: curve.width})
      figure.add_glyph(line, source, {name: curve.name, visible: curve.visible})
      views.push({...curve, source})
    }
    const tools = [
      new M.WheelZoomTool({dimensions: 'width', modifiers: {ctrl: true}}), cursor,
      new M.PanTool(), new M.BoxZoomTool(), new M.ResetTool(),
    ]
    figure.add_tools(...tools)
    return {figure, tools}
  },

  // Draws plots below one another that share a time axis, and fills their curves on every zoom.
  async plot(name, drawn) {
    const M = Bokeh.require('models/index')
    const range = new M.Range1d({start: drawn.start, end: drawn.end, bounds: 'auto'})
    const overlay = new M.Span({dimension: 'height', line_color: this.GREY})
    const cursor = new M.CrosshairTool({dimensions: 'height', overlay})
    const views = []
    const made = drawn.figures.map(
      (one) => this.figure(one, drawn.parts, range, cursor, views))
    // one tool for all plots
    const tools = made[0].tools.map(
      (_, k) => new M.ToolProxy({tools: made.map((one) => one.tools[k])}))
    const [wheel, , , box] = tools
    const grid = new M.GridPlot({
      children: made.map(({figure}, k) => [figure, k, 0]), sizing_mode: 'stretch_width',
      toolbar: new M.Toolbar({
        tools, logo: null, autohide: true, active_drag: box, active_scroll: wheel}),
      toolbar_location: 'above',
    })
    const full = await this.unpacked(drawn)
    this.fill[name] = () => this.refill(full, views, range, drawn.tick)
    for (const end of ['start', 'end']) range.connect(range.properties[end].change, this.fill[name])
    const {Document} = Bokeh.require('document/index')
    const all = this.documents[name] = new Document()
    all.add_root(grid)
    await Bokeh.embed.add_document_standalone(all, document.getElementById(name))
    this.fill[name]()
  },

  // Bokeh's document of each plot, and what fills its curves, by the plot's name.
  documents: {},
  fill: {},

  models(name, type) {
    const all = [...this.documents[name]._all_models.values()]
    return all.filter((model) => model.type === type)
  },

  // What the buttons above a plot do with their values.
  actions: {
    // Shows a drive's plots in place of another's.
    drive(name, value) {
      for (const figure of identPage.models(name, 'Figure')) {
        figure.visible = figure.name === `drive-${value}`
      }
      // those behind a tab once more when they are shown
      identPage.fill[name]()
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
      await this.plot(script.dataset.draws, JSON.parse(script.textContent))
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
