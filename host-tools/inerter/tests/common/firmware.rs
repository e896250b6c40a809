//! Firmware that is older or newer than the program: a device's records, modified on the way.

#![allow(dead_code, reason = "each test file uses its part")]

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    thread,
};

use inerter_wire::{Crc32, Frame, FrameReader, MAX_FRAME, Record, encode_record};

/// Maps a record to the payloads that the other firmware sends instead.
pub type Change = fn(&Record) -> Vec<Vec<u8>>;

/// A proxy for the device at this address. Returns the address at which the other firmware accepts one host after
/// another.
pub fn before(device: &str, change: Change) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let device = device.to_string();
    thread::spawn(move || {
        for host in listener.incoming() {
            let (host, device) = (host.unwrap(), TcpStream::connect(&device).unwrap());
            let (mut requests, mut to_device) = (host.try_clone().unwrap(), device.try_clone().unwrap());
            thread::spawn(move || {
                std::io::copy(&mut requests, &mut to_device).ok();
                to_device.shutdown(std::net::Shutdown::Both).ok();
            });
            answers(device, host, change);
        }
    });
    address
}

fn answers(mut device: TcpStream, mut host: TcpStream, change: Change) {
    let mut reader = FrameReader::<Record>::new();
    let mut sequence = 0u16;
    let mut portion = [0; 4096];
    while let Ok(count @ 1..) = device.read(&mut portion) {
        let mut input = portion.get(..count).unwrap();
        let mut out = Vec::new();
        while let Some(frame) = reader.read(&mut input) {
            let Frame::Message { message, .. } = frame else { continue };
            for payload in change(&message) {
                out.extend(framed(&payload, sequence));
                sequence = sequence.wrapping_add(1);
            }
        }
        if host.write_all(&out).is_err() {
            break;
        }
    }
    host.shutdown(std::net::Shutdown::Both).ok();
}

/// A frame with any payload, including its delimiter.
pub fn framed(payload: &[u8], sequence: u16) -> Vec<u8> {
    let mut body = [payload, &sequence.to_le_bytes()].concat();
    body.extend(Crc32::of(&body).to_le_bytes());
    let mut frame = vec![0; cobs::max_encoding_length(body.len())];
    let length = cobs::encode(&body, &mut frame);
    frame.truncate(length);
    frame.push(0);
    frame
}

/// The payload of an unmodified record.
pub fn payload(record: &Record) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode_record(record, 0, &mut frame).unwrap();
    let mut body = [0; MAX_FRAME];
    let length = cobs::decode(frame.get(..length - 1).unwrap(), &mut body).unwrap();
    body.get(..length - 6).unwrap().to_vec()
}
