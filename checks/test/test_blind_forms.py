# SPDX-License-Identifier: Apache-2.0
"""The generator's forms: complete, sourced, clear of the catalogue, and physical."""

from dataclasses import replace
import re

import numpy as np
import pytest

from checks.blind.forms import draw_form, FORMS, starts_of, suits
from checks.blind.forms.controller import times
from checks.blind.forms.form import CLEAR
from checks.blind.forms.outside import bad_state
from checks.blind.machines import machine_of, read_plain
from checks.blind.planning import forms_of
from checks.reference.bag_making import draw_parameters
from checks.reference.twin import twin_of
from ros2_ident.effects import CATALOGUE
from ros2_ident.effects.effect import Effect
from ros2_ident.errors import IdentError
from ros2_ident.models import make_model
from ros2_ident.recording import Dataset
from ros2_ident.simulate.motions import draw_motion

PLAIN = read_plain('config/tripod.yaml')
MACHINE = machine_of(PLAIN)
PARAMETERS = draw_parameters(MACHINE, np.random.default_rng(2))
MOTION = draw_motion('mixed', MACHINE, 1.6, 4)
FITTING = [name for name, form in FORMS.items() if suits(form, MACHINE)]


def simulated(*effects) -> np.ndarray:
    log = twin_of(MACHINE).simulate(
        MACHINE, PARAMETERS, MOTION.position, MOTION.velocity, effects, 1e-6, 1e-7
    )
    return log.effort


@pytest.fixture(scope='module')
def nominal() -> np.ndarray:
    return simulated()


def judged() -> dict[str, Effect]:
    """Return the catalogue's effects of machines that the blind check draws."""
    nothing = np.zeros((len(MACHINE.drives), 400))
    cycle = MACHINE.number('cycle')
    data = Dataset(MACHINE.drives, cycle, 0, nothing, nothing, None, None, nothing)
    return {at.effect: CATALOGUE[at.effect] for at in make_model(MACHINE, data).extensions()}


def test_every_effect_that_is_judged_has_a_form_that_is_not_its_law() -> None:
    assert len(judged()) >= 25
    for name, effect in judged().items():
        forms = [form for form in FORMS.values() if form.effect == name]
        assert forms, name
        assert all(form.law != effect.equation for form in forms), name
    assert not {form.effect for form in FORMS.values()} - {'', *CATALOGUE}
    outside = [form for form in FORMS.values() if not form.effect]
    assert len(outside) >= 9
    assert not {form.name for form in outside} & set(CATALOGUE)


@pytest.mark.parametrize('form', FORMS.values(), ids=lambda form: form.name)
def test_a_form_says_where_it_is_from(form) -> None:
    assert re.search(r'\b(18|19|20)\d\d\b', form.source), form.source
    assert re.match(r'[A-Z]|polytropic|incremental', form.source)
    assert len(form.law) > 10


@pytest.mark.parametrize('form', FORMS.values(), ids=lambda form: form.name)
def test_no_number_is_drawn_where_a_search_starts(form) -> None:
    numbers = (form.size, *form.others)
    for number in numbers:
        known = {p.name for p in CATALOGUE[form.effect].parameters} if form.effect else set()
        assert not number.counterpart or number.counterpart in known
        assert number.low != number.high and not number.choices  # a range, not a list
    for size in np.linspace(-3.0, 3.5, 40):
        for seed in range(8):
            values = draw_form(form, MACHINE, 'drive_1', float(size), seed).values
            for number in numbers:
                drawn = abs(values[number.name]) / number.scale(MACHINE)
                for start in starts_of(form.effect, number.counterpart):
                    assert abs(drawn - start) >= CLEAR * abs(start), (number.name, drawn, start)


def test_ranges_that_mean_a_catalogued_shape_say_so() -> None:
    """Shapes that a search starts from have to be named by some form, else nothing is avoided."""
    named = {(f.effect, n.counterpart) for f in FORMS.values() for n in (f.size, *f.others)}
    for name, effect in judged().items():
        for parameter in effect.parameters:
            # Places are shares of a stroke: no form's is one of them.
            placed = parameter.role == 'position'
            if parameter.starts and not placed and parameter.name not in ('share', 'damping'):
                assert (name, parameter.name) in named, (name, parameter.name)


def changes(form, size, nominal) -> np.ndarray:
    """Return (D,) the RMS change of the effort by a form on the second drive."""
    hidden = draw_form(form, MACHINE, 'drive_2', size, 5)
    if form.name == 'end_contact':  # else behind the reach of this motion
        hidden = replace(hidden, values={**hidden.values, 'place': 0.42})
    return np.sqrt(np.mean((simulated(hidden) - nominal) ** 2, axis=1))


@pytest.mark.parametrize('name', FITTING)
def test_a_form_acts_on_its_drive_and_fades_with_its_size(name, nominal) -> None:
    form = FORMS[name]
    # A limit has to reach down to what a short motion needs.
    large = changes(form, 3.5 if name == 'limit.speed' else 1.0, nominal)
    assert np.isfinite(large).all()
    assert large[1] > 3e-5
    if form.place == 'drive':
        assert int(np.argmax(large)) == 1
    if form.fades:
        assert changes(form, -2.0, nominal).max() < 0.5 * large.max()


def test_the_law_without_a_form_is_the_reference(nominal) -> None:
    some = draw_form(FORMS['stribeck.rational'], MACHINE, 'drive_1', 0.0, 1)
    nothing = replace(some, values={**some.values, 'torque': 0.0})
    np.testing.assert_allclose(simulated(nothing), nominal, atol=1e-9)


def test_a_payload_comes_and_goes() -> None:
    hidden = draw_form(FORMS['payload.turns'], MACHINE, 'drive_1', 0.9, 3)
    still = np.repeat(MOTION.position[:, :1], 16000, axis=1)
    # Dry friction would bear a part of the load.
    smooth = {k: 0.0 if 'coulomb' in k else v for k, v in PARAMETERS.items()}
    log = twin_of(MACHINE).simulate(
        MACHINE, smooth, still, np.zeros_like(still), [hidden], 1e-6, 1e-7
    )
    time = np.arange(16000) * log.cycle - PARAMETERS['measurement_delay']
    begin, held, free = (hidden.values[n] for n in ('begin', 'held_1', 'free_1'))
    total = log.effort.sum(axis=0)

    def mean(first: float, last: float) -> float:
        return float(total[(time > first) & (time < last)].mean())

    before = mean(0.0, begin)
    carried = mean(begin + 0.5 * held, begin + held) - before
    gear, gravity = MACHINE.number('gear_factor'), MACHINE.number('gravity')
    assert carried == pytest.approx(hidden.values['mass'] * gravity / gear, rel=0.05)
    put_down = mean(begin + held + 0.6 * free, begin + held + free) - before
    assert abs(put_down) < 0.1 * abs(carried)
    assert sum(np.abs(np.diff(total > before + 0.5 * carried))) >= 4


def test_bursts_have_their_length_and_share() -> None:
    lost = bad_state(np.random.default_rng(1), 200_000, 0.05, 4.0)
    assert lost.mean() == pytest.approx(0.05, rel=0.1)
    begins = np.flatnonzero(lost & ~np.roll(lost, 1))
    assert lost.sum() / begins.size == pytest.approx(4.0, rel=0.1)
    assert not lost[0]


def test_a_drive_that_is_not_there_is_refused() -> None:
    hidden = draw_form(FORMS['bias.warming'], MACHINE, 'drive_9', 0.5, 1)
    with pytest.raises(IdentError, match='no drive drive_9'):
        simulated(hidden)


def test_forms_of_a_machine_leave_out_what_it_identifies_anyway() -> None:
    forms = forms_of(MACHINE)
    assert set(forms['stribeck']) == {'stribeck.exponential', 'stribeck.rational'}
    assert 'coulomb_friction' not in forms and 'gear_flexibility' not in forms
    assert 'loose_part' in forms


def test_a_gain_that_is_far_too_small_keeps_its_sign() -> None:
    hidden = draw_form(FORMS['gain.integral'], MACHINE, 'drive_1', 1.3, 3)
    assert abs(hidden.values['share']) > 1.0
    assert times(-abs(hidden.values['share'])) > 0.3 and times(0.4) == 1.4
