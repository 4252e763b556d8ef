// SPDX-License-Identifier: Apache-2.0
'use strict'

const identLive = {
  EVERY: 1, // s between two questions
  LATE: 5, // news older than so many seconds are said to be old
  last: null,

  time(seconds) {
    if (seconds === null) return '?'
    const whole = Math.max(0, Math.round(seconds))
    return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, '0')}`
  },

  // A picture with one path a curve, in user units of `wide` by `high`.
  picture(wide, high, label, curves, marks) {
    const svg = `<svg class="chart" viewBox="0 0 ${wide} ${high}" role="img"></svg>`
    const holder = document.createElement('div')
    holder.innerHTML = svg
    const made = holder.firstChild
    made.setAttribute('aria-label', label)
    for (const [name, points] of curves) {
      const path = document.createElementNS('http://www.w3.org/2000/svg', 'path')
      path.setAttribute('class', name)
      let pen = 'M'
      path.setAttribute('d', points.map(([x, y]) => {
        if (y === null) { pen = 'M'; return '' }
        const step = `${pen}${x.toFixed(1)} ${y.toFixed(1)}`
        pen = 'L'
        return step
      }).join(''))
      made.append(path)
    }
    for (const [x, y, text, place] of marks) {
      const word = document.createElementNS('http://www.w3.org/2000/svg', 'text')
      word.setAttribute('x', x)
      word.setAttribute('y', y)
      word.setAttribute('class', place)
      word.textContent = text
      made.append(word)
    }
    return made
  },

  digits(value) {
    return String(Number(value.toPrecision(3))).replace('-', '−')
  },

  // Curves over one axis of time, between the least and the largest of all their values.
  curves(time, rows, unit, label, {log = false, high = 150} = {}) {
    const left = 76, wide = innerWidth < 760 ? 420 : 900, low = high - 26
    const seen = rows.flatMap(([, values]) => values).filter((x) => x !== null)
    const scale = (x) => log ? Math.log(Math.max(x, 1e-300)) : x
    let least = scale(Math.min(...seen)), most = scale(Math.max(...seen))
    if (!(most > least)) [least, most] = [least - 1, least + 1]
    const first = time[0], last = time.at(-1) > time[0] ? time.at(-1) : time[0] + 1
    const x = (t) => left + (wide - left - 14) * (t - first) / (last - first)
    const y = (v) => v === null ? null : low - (low - 14) * (scale(v) - least) / (most - least)
    const drawn = rows.map(([name, values]) => [name, values.map((v, k) => [x(time[k]), y(v)])])
    const frame = ['grid', [[left, 14], [left, low], [wide - 14, low]]]
    const top = Math.max(...seen), bottom = Math.min(...seen)
    return this.picture(wide, high, label, [frame, ...drawn], [
      [left - 8, 19, this.digits(top), 'end'],
      [left - 8, low, this.digits(bottom), 'end'],
      [left - 8, (14 + low) / 2 + 5, unit, 'end'],
      [left, high - 6, `${Math.round(first)} s`, ''],
      [wide - 14, high - 6, `${last < 10 ? this.digits(last) : Math.round(last)} s`, 'end'],
    ])
  },

  costs(news) {
    const figure = document.getElementById('costs')
    figure.hidden = !news.costs?.length
    if (figure.hidden) return
    const [times, values] = [0, 1].map((k) => news.costs.map((row) => row[k]))
    figure.querySelector('svg')?.remove()
    figure.prepend(this.curves(times, [['line', values]], news.unit,
      `Best cost over time, now ${news.best}`, {log: true, high: 130}))
  },

  efforts(news) {
    const place = document.getElementById('efforts')
    if (!place || !news.efforts?.length) return
    place.replaceChildren(...news.efforts.map((drive) => {
      const figure = document.createElement('figure')
      const words = document.createElement('figcaption')
      words.textContent = drive.drive
      figure.append(words, this.curves(drive.time,
        [['measured', drive.measured], ['line', drive.simulated]], drive.unit,
        `${drive.drive}: measured and simulated effort over time`))
      return figure
    }))
  },

  parameters(news) {
    const table = document.getElementById('values')
    if (!table || !news.parameters?.length) return
    while (table.rows.length > 1) table.deleteRow(1)
    for (const {name, value, trace, ends} of news.parameters) {
      const row = table.insertRow()
      const head = document.createElement('th')
      head.scope = 'row'
      head.textContent = name
      row.append(head)
      const number = row.insertCell()
      number.className = 'n'
      number.textContent = value
      const box = row.insertCell()
      box.innerHTML = '<div class="box"><b></b></div>'
      box.firstChild.title = ends
      box.querySelector('b').style.left = `${100 * trace.at(-1)}%`
      const changed = trace.length > 1 ? trace : [trace[0], trace[0]]
      const path = changed.map((v, k) => [220 * k / (changed.length - 1), 24 - 22 * v])
      const line = this.picture(220, 26, `${name} within its bounds over time`, [['line', path]], [])
      line.style.width = '220px'
      row.insertCell().append(line)
    }
  },

  notes(news) {
    const list = document.getElementById('notes')
    list.hidden = !news.notes?.length
    list.replaceChildren(...(news.notes ?? []).map(([when, text]) => {
      const item = document.createElement('li')
      item.textContent = `${this.time(when)}: ${text}`
      return item
    }))
  },

  // What is true now, also between two news: the time goes on.
  words() {
    const news = this.last
    if (!news) return
    const headline = document.getElementById('headline'), times = document.getElementById('times')
    const age = Date.now() / 1000 - news.written
    const heading = {
      preparing: 'Preparing: data are read, and a new kind of machine is compiled',
      ended: `The run ended without a report: ${news.why}`,
    }[news.state] ?? `${news.what[0].toUpperCase()}${news.what.slice(1)}`
    if (headline.textContent !== heading) headline.textContent = heading
    const said = []
    if (news.state === 'running') {
      said.push(`${this.time(news.gone)} gone`, `about ${this.time(news.left)} to go`)
      if (news.left === null) said[1] = 'time to go not known yet'
      if (news.best) said.push(`best ${news.best}`, `${news.candidates} candidates`)
    }
    if (age > this.LATE && news.state !== 'ended') {
      said.push(`no news for ${this.time(age)}`)
    }
    times.textContent = said.join(', ')
  },

  show(news) {
    this.last = news
    document.documentElement.dataset.news = news.state
    this.words()
    const bar = document.querySelector('.bar.whole'), share = Math.round(100 * (news.share ?? 0))
    bar.setAttribute('aria-valuenow', share)
    bar.querySelector('b').style.width = `${share}%`
    this.notes(news)
    this.costs(news)
    this.efforts(news)
    this.parameters(news)
  },

  // The file is asked for as a script, the one way without a server.
  ask() {
    const script = document.createElement('script')
    const again = () => { script.remove(); setTimeout(() => this.ask(), 1000 * this.EVERY) }
    script.onload = () => { this.words(); again() }
    script.onerror = () => {
      // It is gone once the report is written.
      if (this.last && this.last.state !== 'ended') return location.reload()
      document.getElementById('headline').textContent = `There is no ${this.file} beside this page: nothing is known of the run`
      again()
    }
    script.src = `${this.file}?${Date.now()}`
    document.head.append(script)
  },
}

function identNews(news) { if (news.written !== identLive.last?.written) identLive.show(news) }
