//! `docs/PROTOCOL.md` compared with the code: this test generates its tables, layouts and worked example.

use crate::frames::{framed, hex, payload};
use crate::reference;
use crate::values::{detail, estimate, few_samples, law, reversal};
use inerter_core::{
    BacklashSize, BacklashStatus, Bank, Changed, Contact, LawStatus, Machine, Parameter, Reason, Regime, Route, Status,
    WarningKind,
};
use inerter_wire::catalogue::{Field, Group, fields};
use inerter_wire::protocol::{COMMANDS, Entry, RECORDS};
use inerter_wire::*;
use serde::de::DeserializeOwned;
use serde_reflection::{ContainerFormat, Format, Registry, Samples as Traces, Tracer, TracerConfig, VariantFormat};
use std::collections::BTreeSet;
use std::fmt::Write;

const BEGIN: &str =
    "<!-- Made from the code from here on: UPDATE_PROTOCOL=1 cargo test -p inerter-wire specification -->";
const END: &str = "<!-- Made from the code up to here. -->";

/// The layouts of these types. Enums are traced one by one, so that every variant is covered.
macro_rules! traced {
    ($($traced:ty),+ $(,)?) => {{
        let mut tracer = Tracer::new(TracerConfig::default());
        $(tracer.trace_type::<$traced>(&Traces::new()).unwrap();)+
        tracer.registry().unwrap()
    }};
}

fn registry() -> Registry {
    traced!(
        Status,
        Bank,
        Reason,
        BacklashStatus,
        Route,
        Contact,
        Regime,
        LawStatus,
        Changed,
        WarningKind,
        ClockSource,
        Source,
        Fault,
        ResetCause,
        EventKind,
        SettingFault,
        Refusal,
        Measure,
        Play,
        Done,
        Result<Done, Refusal>,
        Command,
        Request,
        Record,
    )
}

/// Names of a struct's fields, in order.
pub fn fields_of<T: DeserializeOwned>(name: &str) -> Vec<String> {
    let mut registry = traced!(Parameter, Bank, Reason, BacklashSize, Route, Contact, Regime, LawStatus, T);
    match registry.remove(name) {
        Some(ContainerFormat::Struct(fields)) => fields.into_iter().map(|field| field.name).collect(),
        other => panic!("{name} is {other:?}"),
    }
}

fn form(format: &Format) -> String {
    match format {
        Format::TypeName(name) => format!("`{name}`"),
        Format::Bool => "bool".into(),
        Format::U8 => "u8".into(),
        Format::U16 => "u16".into(),
        Format::U32 => "u32".into(),
        Format::U64 => "u64".into(),
        Format::I16 => "i16".into(),
        Format::I32 => "i32".into(),
        Format::I64 => "i64".into(),
        Format::I128 => "i128".into(),
        Format::U128 => "u128".into(),
        Format::F32 => "f32".into(),
        Format::F64 => "f64".into(),
        Format::Str => "text".into(),
        Format::Option(inner) => format!("option of {}", form(inner)),
        Format::Seq(inner) => format!("list of {}", form(inner)),
        Format::TupleArray { content, size } => format!("{size} times {}", form(content)),
        Format::Tuple(inner) => inner.iter().map(form).collect::<Vec<_>>().join(", "),
        other => panic!("no word for {other:?}"),
    }
}

fn variant(format: &VariantFormat) -> String {
    match format {
        VariantFormat::Unit => String::new(),
        VariantFormat::NewType(inner) => form(inner),
        VariantFormat::Tuple(inner) => inner.iter().map(form).collect::<Vec<_>>().join(", "),
        VariantFormat::Struct(fields) => {
            fields.iter().map(|field| format!("{}: {}", field.name, form(&field.value))).collect::<Vec<_>>().join(", ")
        }
        other => panic!("no word for {other:?}"),
    }
}

/// Types that a format refers to.
fn parts(container: &ContainerFormat) -> Vec<String> {
    let mut names = Vec::new();
    let mut note = |format: &Format| {
        let text = form(format);
        names.extend(text.split('`').skip(1).step_by(2).map(String::from));
    };
    match container {
        ContainerFormat::Struct(fields) => fields.iter().for_each(|field| note(&field.value)),
        ContainerFormat::NewTypeStruct(inner) => note(inner),
        ContainerFormat::Enum(variants) => {
            for named in variants.values() {
                match &named.value {
                    VariantFormat::NewType(inner) => note(inner),
                    VariantFormat::Struct(fields) => fields.iter().for_each(|field| note(&field.value)),
                    _ => {}
                }
            }
        }
        other => panic!("no layout for {other:?}"),
    }
    names
}

fn layout(out: &mut String, registry: &Registry, name: &str, done: &mut BTreeSet<String>) {
    if !done.insert(name.into()) {
        return;
    }
    let container = &registry[name];
    if !matches!(name, "Record" | "Command") {
        writeln!(out, "#### `{name}`\n").unwrap();
        match container {
            ContainerFormat::Struct(fields) => {
                out.push_str("| field | form |\n|---|---|\n");
                for field in fields {
                    writeln!(out, "| {} | {} |", field.name, form(&field.value)).unwrap();
                }
            }
            ContainerFormat::NewTypeStruct(inner) => writeln!(out, "{}", form(inner)).unwrap(),
            ContainerFormat::Enum(variants) => {
                out.push_str("| number | variant | content |\n|---|---|---|\n");
                for (number, named) in variants {
                    writeln!(out, "| {number} | {} | {} |", named.name, variant(&named.value)).unwrap();
                }
            }
            other => panic!("no layout for {other:?}"),
        }
        out.push('\n');
    }
    for part in parts(container) {
        layout(out, registry, &part, done);
    }
}

fn table(out: &mut String, title: &str, entries: &[Entry], variants: &ContainerFormat) {
    let ContainerFormat::Enum(variants) = variants else { panic!("{variants:?}") };
    assert_eq!(variants.len(), entries.len());
    writeln!(out, "### {title}\n\n| number | name | content | meaning |\n|---|---|---|---|").unwrap();
    for Entry { number, name, doc } in entries {
        let named = &variants[number];
        assert_eq!(named.name, *name);
        writeln!(out, "| {number} | {name} | {} | {doc} |", variant(&named.value)).unwrap();
    }
    out.push('\n');
}

fn example<T: Message>(out: &mut String, title: &str, message: &T, sequence: u16) {
    let payload = payload(message);
    let crc = reference::crc32(&[&payload[..], &sequence.to_le_bytes()].concat()) ^ T::SALT;
    writeln!(
        out,
        "{title}\n\n```text\npayload   {}\nsequence  {}\nCRC-32    {}  (0x{crc:08X})\nframe     {}\n```\n",
        hex(&payload),
        hex(&sequence.to_le_bytes()),
        hex(&crc.to_le_bytes()),
        hex(&framed(message, sequence))
    )
    .unwrap();
}

fn generated() -> String {
    let registry = registry();
    let mut out = String::new();
    writeln!(
        out,
        "Wire version {WIRE_VERSION}. Longest payload {MAX_PAYLOAD} bytes, longest frame {MAX_FRAME} with its delimiter; a\n\
         batch holds at most {} samples in {} bytes, a list of settings at most {MAX_SETTINGS}.\n",
        Samples::MAX_SAMPLES,
        Samples::MAX_BYTES
    )
    .unwrap();
    table(&mut out, "Records (device to host)", RECORDS, &registry["Record"]);
    table(&mut out, "Commands (host to device)", COMMANDS, &registry["Command"]);
    out.push_str("### Layouts\n\nFields follow each other in this order, without padding.\n\n");
    let mut done = BTreeSet::new();
    for name in ["Record", "Request"] {
        layout(&mut out, &registry, name, &mut done);
    }
    assert_eq!(done.len(), registry.len(), "every type is described");
    out.push_str("### Figures that a board measures\n\n| quantity | name | meaning | unit |\n|---|---|---|---|\n");
    for (number, field) in fields(Machine::Linear, Group::Measured).enumerate() {
        let Field { path, label, unit, .. } = field;
        writeln!(out, "| {number} | {path} | {label} | {unit} |").unwrap();
    }
    out.push('\n');
    out.push_str("### Worked examples\n\n");
    let request = Request { id: 1, command: Command::Hello };
    example(&mut out, "The host's first frame, `Request { id: 1, command: Hello }`, sequence 0:", &request, 0);
    let reply = Record::Reply(Reply { id: 1, result: Ok(Done::Plain) });
    example(&mut out, "The device's answer, `Reply { id: 1, result: Ok(Plain) }`, sequence 2:", &reply, 2);
    let samples = Record::Samples(few_samples());
    example(
        &mut out,
        "Three samples, (3, -1, 0, 0), (4, 63, 0, 0) and, one being lost, (6, 63, 0, 0), sequence 258:",
        &samples,
        258,
    );
    example(&mut out, "An estimate (the golden of the test suite), sequence 259:", &Record::Estimate(estimate()), 259);
    example(&mut out, "The Law record of that estimate, sequence 260:", &Record::Law(law()), 260);
    example(&mut out, "The Detail record of that estimate, sequence 261:", &Record::Detail(detail()), 261);
    example(&mut out, "A reversal with 52.5 um of backlash, sequence 262:", &Record::Reversal(reversal()), 262);
    out
}

#[test]
fn document_is_up_to_date() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/PROTOCOL.md");
    let text = std::fs::read_to_string(path).unwrap();
    let (head, rest) = text.split_once(BEGIN).expect("the mark that begins the generated part");
    let (present, tail) = rest.split_once(END).expect("the mark that ends the generated part");
    let wanted = format!("\n\n{}", generated());
    if present == wanted {
        return;
    }
    assert!(
        std::env::var_os("UPDATE_PROTOCOL").is_some(),
        "docs/PROTOCOL.md is out of date: UPDATE_PROTOCOL=1 cargo test -p inerter-wire specification"
    );
    std::fs::write(path, format!("{head}{BEGIN}{wanted}{END}{tail}")).unwrap();
}

#[test]
fn tables_are_whole() {
    for entries in [RECORDS, COMMANDS] {
        for (place, entry) in entries.iter().enumerate() {
            assert_eq!(entry.number as usize, place);
            assert!(entry.doc.ends_with('.') && !entry.doc.contains('|'), "{}", entry.name);
        }
    }
}
