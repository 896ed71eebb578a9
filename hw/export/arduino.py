"""Arduino sketch: the code played by an Uno's output compare, without a host."""

from __future__ import annotations

from string import Template

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, hex_rows, packed_bytes, value_in
from hw.program import Program

_LEAST_TICKS = 100  # 50 us: the longest path through the interrupt, with some to spare
_MOST_TICKS = 65_535  # Timer 1 counts 16 bits
_MOST_CHIPS = 65_535  # the index of the chip has 16 bits

_SKETCH = Template("""\
// Shutter program written by coded-exposure: $chips chips of $chip_ns ns.
// For an Arduino Uno or Nano (ATmega328P, 16 MHz).
// CRC32 $crc (zlib) over chip_ns as u64, chips as u32, both little endian, and the bytes of code.
//
// D9 is the shutter. It needs a resistor of 10 kOhm to its closed level: while the board starts, pins float.
// A rising edge on D2, or the letter t at 115200 baud, plays the code once; the first chip begins one chip time later.
// Further ones during the play do nothing.
// The edges are made by the output compare of Timer1, hence exact to the clock cycle whatever else runs.

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/wdt.h>
#include <stdint.h>

#if !defined(__AVR_ATmega328P__) || F_CPU != 16000000UL
#error "this sketch is for an ATmega328P at 16 MHz: choose Arduino Uno or Nano"
#endif

#define CHIPS ${chips}u
#define TICKS ${ticks}u  // of 0.5 us per chip
#define CLOSED_LEVEL $closed  // of D9

static const uint8_t code[] PROGMEM = {
$array
};

// What the timer does to D9 at its next match.
#if CLOSED_LEVEL
#define CLOSE_AT_MATCH (_BV(COM1A1) | _BV(COM1A0))
#define OPEN_AT_MATCH _BV(COM1A1)
#else
#define CLOSE_AT_MATCH _BV(COM1A1)
#define OPEN_AT_MATCH (_BV(COM1A1) | _BV(COM1A0))
#endif

static volatile uint8_t playing = 0;
static uint16_t chip = 0;

static uint8_t at_match(uint16_t index) {
  if (index >= CHIPS) return CLOSE_AT_MATCH;
  uint8_t eight = pgm_read_byte(&code[index >> 3]);
  return (eight >> (7 - (index & 7))) & 1 ? OPEN_AT_MATCH : CLOSE_AT_MATCH;
}

static void stop() {
  TCCR1B = _BV(WGM12);
  TIMSK1 = 0;
  TCCR1A = CLOSE_AT_MATCH;
  TCCR1C = _BV(FOC1A);  // the compare unit remembers its level: leave it closed
  TCCR1A = 0;           // D9 follows PORTB, which is closed
  playing = 0;
  EIFR = _BV(INTF0);  // edges during the play are no triggers
  EIMSK = _BV(INT0);
}

static void play() {
  if (playing) return;
  EIMSK = 0;  // its interrupt outranks the timer's: triggers in quick succession would hold the shutter open
  playing = 1;
  chip = 0;
  TCNT1 = 0;
  OCR1A = TICKS - 1;
  TIFR1 = _BV(OCF1A);
  TCCR1A = at_match(0);
  TIMSK1 = _BV(OCIE1A);
  GTCCR = _BV(PSRSYNC);
  TCCR1B = _BV(WGM12) | _BV(CS11);
}

// The timer has just put this chip on D9; what follows has a chip time to get ready.
ISR(TIMER1_COMPA_vect) {
  if (chip == CHIPS) {
    stop();
    return;
  }
  TCCR1A = at_match(++chip);
  if (TIFR1 & _BV(OCF1A)) stop();  // too late for the next chip: a wrong code must not go on
}

ISR(INT0_vect) { play(); }

void setup() {
  cli();
  MCUSR = 0;
  wdt_enable(WDTO_60MS);  // a hang ends in a reset, and with the resistor in a closed shutter
  TIMSK0 = 0;             // no millis(): nothing but the trigger and the code interrupts
#if CLOSED_LEVEL
  PORTB |= _BV(PORTB1);
#else
  PORTB &= ~_BV(PORTB1);
#endif
  stop();
  DDRB |= _BV(DDB1);
  DDRD &= ~_BV(DDD2);
  PORTD |= _BV(PORTD2);  // an open trigger input stays quiet
  EICRA = _BV(ISC01) | _BV(ISC00);
  EIFR = _BV(INTF0);  // stop() has enabled its interrupt
  UCSR0A = _BV(U2X0);
  UBRR0 = 16;
  UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
  UCSR0B = _BV(RXEN0);
  sei();
}

void loop() {
  wdt_reset();
  if ((UCSR0A & _BV(RXC0)) && UDR0 == 't') {
    cli();
    play();
    sei();
  }
}
""")


class ArduinoSketch(Exporter):
    """Sketch whose edges the output compare of Timer 1 makes."""

    name = "arduino"
    suffix = ".ino"
    summary = "sketch for an Arduino Uno or Nano that plays the code on D9 at a trigger on D2"
    needs = "an Arduino Uno or Nano (ATmega328P, 16 MHz)"
    manual = "Microchip ATmega328P datasheet: Timer 1, output compare"
    tick_ns = 500

    def export(self, program: Program, device: DeviceProfile = GENERIC, /) -> str:
        """Write the sketch; the Arduino IDE wants it in a folder of the same name."""
        ticks = self.ticks(program, "the sketch", min_ticks=_LEAST_TICKS, max_ticks=_MOST_TICKS)
        if program.chips > _MOST_CHIPS:
            raise ValueError(
                f"code of {program.chips} chips is too long for the sketch: at most {_MOST_CHIPS}"
            )
        return _SKETCH.substitute(
            chips=program.chips,
            chip_ns=program.chip_ns,
            ticks=ticks,
            closed=device.closed_level,
            crc=f"0x{program.code_crc32:08x}",
            array=hex_rows(program.to_bytes(), per_line=16, indent="  "),
        )

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the array and the timer's period."""
        chips = int(value_in(text, r"^#define CHIPS (\d+)u$"))
        ticks = int(value_in(text, r"^#define TICKS (\d+)u "))
        packed = packed_bytes(value_in(text, r"code\[\] PROGMEM = \{([^{}]*)\};$"))
        return Program.from_bytes(packed, chips=chips, chip_ns=ticks * self.tick_ns)
