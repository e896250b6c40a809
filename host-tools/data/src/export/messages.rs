//! MCAP: every sample as JSON, for PlotJuggler and Foxglove.

use std::{collections::BTreeMap, fs::File, io::BufWriter};

use mcap::{WriteOptions, records::MessageHeader, write::Metadata};
use serde::Serializer;
use serde_json::json;

use super::{Column, Row, Source, about, selection::Sink};
use crate::{
    output::{OutputError, Pending},
    recording::{CALIBRATION_METADATA, SETTINGS_METADATA, into_io},
    words::bracketed,
};

/// Size of a chunk, which a viewer reads at once \[bytes\].
const CHUNK: u64 = 1 << 20;

/// An MCAP file being written.
pub(super) struct Mcap {
    name: String,
    columns: Vec<Column>,
    writer: mcap::Writer<BufWriter<File>>,
    channel: u16,
    sequence: u32,
    line: Vec<u8>,
}

impl Mcap {
    pub(super) fn create(file: &Pending, source: &Source, columns: Vec<Column>) -> Result<Self, OutputError> {
        let failed = |error| failed(&file.name(), error);
        let options = WriteOptions::new()
            .profile("inerter-samples")
            .library(concat!("inerter ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(CHUNK));
        let mut writer = options.create(BufWriter::with_capacity(1 << 16, file.open()?)).map_err(failed)?;
        let machine = source.settings.machine;
        let property = |column: &Column| {
            let name = column.name(machine).to_string();
            let description = format!("{name}{}", bracketed(column.unit(machine)));
            (name, json!({"type": "number", "description": description}))
        };
        let properties: serde_json::Map<_, _> = columns.iter().map(property).collect();
        let schema = json!({"title": "Samples in SI", "type": "object", "properties": properties}).to_string();
        let schema = writer.add_schema("inerter.samples", "jsonschema", schema.as_bytes()).map_err(failed)?;
        let channel = writer.add_channel(schema, "samples", "json", &BTreeMap::new()).map_err(failed)?;
        let metadata =
            about::settings_by_name(source).into_iter().map(|(name, value)| (name, value.to_string())).collect();
        let settings = Metadata { name: SETTINGS_METADATA.into(), metadata };
        writer.write_metadata(&settings).map_err(failed)?;
        if let Some(calibration) = &source.calibration {
            let calibration = Metadata { name: CALIBRATION_METADATA.into(), metadata: calibration.texts() };
            writer.write_metadata(&calibration).map_err(failed)?;
        }
        Ok(Self { name: file.name(), columns, writer, channel, sequence: 0, line: Vec::new() })
    }
}

impl Sink for Mcap {
    fn take(&mut self, source: &Source, rows: &[Row]) -> Result<(), OutputError> {
        let machine = source.settings.machine;
        for (sample, point) in rows {
            let cells = self.columns.iter().map(|column| (column.name(machine), column.cell(source, sample, point)));
            self.line.clear();
            let json = serde_json::Serializer::new(&mut self.line).collect_map(cells);
            json.map_err(|error| OutputError::write(&self.name, error.into()))?;
            let since_s = point.elapsed as f64 / source.settings.sample_rate_hz;
            let time_ns = source.first_ns.saturating_add((since_s * 1e9).round() as u64);
            let header = MessageHeader {
                channel_id: self.channel,
                sequence: self.sequence,
                log_time: time_ns,
                publish_time: time_ns,
            };
            self.sequence = self.sequence.wrapping_add(1);
            self.writer.write_to_known_channel(&header, &self.line).map_err(|error| failed(&self.name, error))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), OutputError> {
        self.writer.finish().map(drop).map_err(|error| failed(&self.name, error))
    }
}

fn failed(name: &str, error: mcap::McapError) -> OutputError {
    OutputError::write(name, into_io(error))
}
