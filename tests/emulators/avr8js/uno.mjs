// An Arduino Uno on avr8js: node uno.mjs FIRMWARE.hex EVENTS_FILE DESCRIPTOR, the last being a pseudo-terminal for the UART.
// Lines on standard input: "trigger PULSES PERIOD" gives rising edges on D2, PERIOD cycles apart. It ends with its standard input.
import fs from "node:fs";
import { createRequire } from "node:module";

const require = createRequire(new URL("../node/package.json", import.meta.url));
const {
  CPU, AVRClock, AVRIOPort, AVRTimer, AVRUSART, AVRWatchdog, avrInstruction, clockConfig, PinState,
  portBConfig, portCConfig, portDConfig, timer0Config, timer1Config, timer2Config, usart0Config, watchdogConfig,
} = require("avr8js");

const CLOCK_HZ = 16e6;
const CYCLES_A_BYTE = 1389;
const CYCLES_A_LOOK = 16000;
const TERMINAL = Number(process.argv[4]);

function readHex(path) {
  const flash = new Uint8Array(32768).fill(0xff);
  for (const line of fs.readFileSync(path, "ascii").split("\n")) {
    if (line[0] !== ":" || line.slice(7, 9) !== "00") continue;
    const bytes = Buffer.from(line.trim().slice(9, -2), "hex");
    flash.set(bytes, parseInt(line.slice(3, 7), 16));
  }
  return new Uint16Array(flash.buffer);
}

const cpu = new CPU(readHex(process.argv[2]));
const clock = new AVRClock(cpu, CLOCK_HZ, clockConfig);
new AVRWatchdog(cpu, watchdogConfig, clock);
for (const config of [timer0Config, timer1Config, timer2Config]) new AVRTimer(cpu, config);
const uart = new AVRUSART(cpu, usart0Config, CLOCK_HZ);
const portB = new AVRIOPort(cpu, portBConfig);
const portC = new AVRIOPort(cpu, portCConfig);
const portD = new AVRIOPort(cpu, portDConfig);

const events = fs.openSync(process.argv[3], "w");
const levels = { shutter: 0, busy: 0, trigger: 0 };
function note(signal, level) {
  if (levels[signal] === level) return;
  levels[signal] = level;
  fs.writeSync(events, `${cpu.cycles} ${signal} ${level}\n`);
}
portB.addListener(() => note("shutter", Number(portB.pinState(1) === PinState.High)));
portC.addListener(() => note("busy", Number(portC.pinState(1) === PinState.High)));

const queue = [];
let feeding = false;
function feed() {
  if (queue.length && uart.writeByte(queue[0])) queue.shift();
  feeding = queue.length > 0;
  if (feeding) cpu.addClockEvent(feed, CYCLES_A_BYTE);
}
fs.createReadStream(null, { fd: TERMINAL }).on("data", (bytes) => {
  queue.push(...bytes);
  if (!feeding) feed();
});
uart.onByteTransmit = (byte) => fs.writeSync(TERMINAL, Uint8Array.of(byte));

// Clock events come late, between instructions: the train keeps its period by the moments at which they were due.
let train = { left: 0, period: 0 };
function trigger(pulses, level, when) {
  if (pulses !== train) return;
  const high = Math.floor(train.period / 2);
  note("trigger", level);
  portD.setPin(2, level === 1);
  if (level) train.left--;
  else if (!train.left) return;
  const next = when + (level ? high : train.period - high);
  cpu.addClockEvent(() => trigger(pulses, 1 - level, next), Math.max(0, next - cpu.cycles));
}
process.stdin.on("data", (text) => {
  for (const [, left, period] of String(text).matchAll(/trigger (\d+) (\d+)/g)) {
    const pulses = (train = { left: Number(left), period: Number(period) });
    const first = cpu.cycles + 1 + Math.floor(Math.random() * CYCLES_A_LOOK);
    cpu.addClockEvent(() => trigger(pulses, 1, first), first - cpu.cycles);
  }
});
process.stdin.on("end", () => process.exit(0));

function run() {
  const stop = cpu.cycles + CYCLES_A_LOOK;
  while (cpu.cycles < stop) {
    avrInstruction(cpu);
    cpu.tick();
  }
  setImmediate(run);
}
run();
