"""A code on each trigger of a belt, played by the emulated controller."""

from emulators.tools import require_simavr

from cep.optics.code import ShutterCode
from cep.shutter.play import play_on_triggers
from hw.emulation.uno import CLOCK_HZ, EmulatedUno

CODE = ShutterCode("1011001110100110", 400_000)


def test_a_belt_is_played_on_every_trigger_and_counted():
    require_simavr()
    with EmulatedUno() as uno:
        uno.trigger(pulses=1000, hertz=10)
        counts = []
        belt = play_on_triggers(uno.port, CODE, plays=3, tell=counts.append)
        assert (belt.plays, belt.missed_edges) == (3, 0)
        assert counts == [1, 2, 3]
        edges = len(uno.edges())
        assert edges == 3 * 2 * CODE.pulses
        cycle = uno.cycle()
        while uno.cycle() < cycle + 0.3 * CLOCK_HZ:
            pass
        assert len(uno.edges()) == edges, "it plays on without the host"


def test_a_belt_without_triggers_ends():
    require_simavr()
    with EmulatedUno() as uno:
        belt = play_on_triggers(uno.port, CODE, plays=3, wait_s=0.2)
    assert belt.plays == 0
