// An RP2040 without a program: registers are read and written from outside, and PIO 0 runs cycle by cycle.
//
// One JSON array a line in, one JSON value a line out: ["read", address], ["write", address, value],
// ["run", cycles], ["input", gpio, level], ["edges", gpio] (those since the last question, as [cycle, level]).
//
// rp2040js 1.4.1 runs PIO on a timer of its own, steps stopped state machines too, and knows no joined queues; what follows
// puts that right, as in sections 3.5 and 3.7 of the RP2040 datasheet.

import { createInterface } from "node:readline";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const require = createRequire(pathToFileURL(process.argv[2] + "/"));
const { RP2040, GPIOPinState } = require("rp2040js");

const PIO0 = 0x50200000;
const SM0_SHIFTCTRL = PIO0 + 0xd0;
const FJOIN_TX = 1 << 30;

const chip = new RP2040();
const pio = chip.pio[0];
const machine = pio.machines[0];
pio.run = () => {};
machine.clkDivRestart = () => {}; // the divider is 1
chip.peripherals[0x40064].readUint32 = () => 1 << 8; // voltage regulator and reset: the power was switched on

let cycle = 0;
const edges = new Map();
chip.gpio.forEach((pin, index) => {
  edges.set(index, []);
  let before = 0; // a pin that floats counts as low: a resistor pulls it down
  pin.addListener((value) => {
    const level = value === GPIOPinState.High ? 1 : 0;
    if (level !== before) edges.get(index).push([cycle, level]);
    before = level;
  });
});

const commands = {
  read: (address) => chip.readUint32(address) >>> 0,
  write(address, value) {
    const joined = machine.shiftCtrl & FJOIN_TX;
    chip.writeUint32(address, value);
    if (address === SM0_SHIFTCTRL && (value & FJOIN_TX) !== joined) {
      machine.txFIFO = new machine.txFIFO.constructor(value & FJOIN_TX ? 8 : 4);
    }
    pio.checkChangedPins();
    return null;
  },
  run(cycles) {
    if (!machine.enabled) {
      cycle += cycles;
      return cycle;
    }
    for (const end = cycle + cycles; cycle < end; ) {
      machine.step();
      cycle += 1;
      pio.checkChangedPins();
    }
    return cycle;
  },
  input(gpio, level) {
    chip.gpio[gpio].setInputValue(Boolean(level));
    return cycle;
  },
  edges: (gpio) => edges.get(gpio).splice(0),
};

for await (const line of createInterface({ input: process.stdin })) {
  const [name, ...values] = JSON.parse(line);
  process.stdout.write(JSON.stringify(commands[name](...values)) + "\n");
}
