// firmware/boards/rp2040 in an emulator, its USB on a TCP port, which is printed, with what the
// device answers to the requests that the emulator's own host does not ask (JSON, one line):
//
//     npm install -g rp2040js
//     NODE_PATH=$(npm root -g) node test/rp2040_board.cjs out/rp2040.uf2
//
// The emulator knows the whole way from boot2 to the USB controller; its time is its own and runs
// several times slower than a host's. A conversion gives `reading(grounded, selected)`.
"use strict";

const fs = require("fs");
const net = require("net");
const { ConsoleLogger, LogLevel, Simulator, USBCDC } = require("rp2040js");

const FLASH = 0x10000000;
const ROM_STACK = 0x20041f00; // where the chip's ROM, which is not here, calls boot2
const GROUND_OFF = 12; // pins as in firmware/boards/rp2040/main.c
const TURNS = 20000; // instructions between two looks at the host

function load(flash, uf2) {
  for (let at = 0; at < uf2.length; at += 512) {
    const size = uf2.readUInt32LE(at + 16);
    flash.set(uf2.subarray(at + 32, at + 32 + size), uf2.readUInt32LE(at + 12) - FLASH);
  }
}

function reading(grounded, selected) {
  return (61 * grounded + 7 * selected + 5) % 4096;
}

function convert(mcu) {
  const pins = mcu.gpio.map((pin) => (pin.value === 1 ? 1 : 0));
  const number = (first) => [0, 1, 2, 3, 4, 5].reduce((sum, k) => sum + (pins[first + k] << k), 0);
  if (pins[GROUND_OFF]) return 4095; // nothing is grounded: all is at the drive voltage
  return reading(number(6), number(0));
}

const simulator = new Simulator();
const mcu = simulator.rp2040;
mcu.logger = new ConsoleLogger(LogLevel.Error, true);
load(mcu.flash, fs.readFileSync(process.argv[2]));
mcu.core.SP = ROM_STACK;
mcu.core.PC = FLASH;
mcu.adc.onADCRead = (channel) => {
  mcu.adc.channelValues[channel] = convert(mcu);
  mcu.adc.currentChannel = channel;
  mcu.adc.sampleAlarm.schedule(2000);
};

const usb = mcu.usbCtrl;
const line = new USBCDC(usb);
const waiting = []; // bytes from the host
let host = null;
line.onSerialData = (bytes) => host && host.write(bytes);

function serve(answers) {
  const server = net.createServer((socket) => {
    host = socket;
    socket.setNoDelay(true);
    socket.on("data", (bytes) => waiting.push(...bytes));
    socket.on("error", () => {});
    socket.on("close", () => (host = null));
  });
  const tell = () => console.log(JSON.stringify({ port: server.address().port, ...answers }));
  server.listen(0, "127.0.0.1", tell);
}

// Control transfers: what is asked, and what is sent along
const CODING = [0x00, 0xc2, 0x01, 0, 0, 0, 8];
const requests = [
  ["device", [0x80, 6, 0, 1, 0, 0, 64, 0]],
  ["product", [0x80, 6, 2, 3, 9, 4, 255, 0]],
  ["configuration", [0x80, 8, 0, 0, 0, 0, 1, 0]],
  ["accepted", [0x21, 0x20, 0, 0, 0, 0, 7, 0], CODING],
  ["coding", [0xa1, 0x21, 0, 0, 0, 0, 7, 0]],
];

function askOn(answers, k) {
  if (k === requests.length) return serve(answers);
  const [name, setup, data] = requests[k];
  usb.onEndpointWrite = (endpoint, buffer) => {
    if (endpoint === 0) {
      answers[name] = [...buffer];
      if (data) next();
    } else if (endpoint === line.inEndpoint) line.onSerialData(buffer);
  };
  usb.onEndpointRead = (endpoint, size) => {
    if (endpoint !== 0) return usualRead(endpoint, size);
    usb.endpointReadDone(0, new Uint8Array(data || []));
    if (!data) next();
  };
  const next = () => simulator.clock.createAlarm(() => askOn(answers, k + 1)).schedule(1e5);
  usb.sendSetupPacket(new Uint8Array(setup));
}
const usualRead = usb.onEndpointRead;
line.onDeviceConnected = () =>
  simulator.clock.createAlarm(() => askOn({}, 0)).schedule(1e6);

function run() {
  while (waiting.length && !line.txFIFO.full) line.sendSerialByte(waiting.shift());
  for (let turn = 0; turn < TURNS; turn++)
    simulator.clock.tick(mcu.core.executeInstruction() * 8); // ns of a cycle at 125 MHz
  setImmediate(run);
}
run();
