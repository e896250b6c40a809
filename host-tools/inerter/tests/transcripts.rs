//! What a person sees: every `.trycmd` file in `tests/cmd` is a session whose output must stay as it is written there.
//! `TRYCMD=overwrite cargo test -p inerter --test transcripts` writes them anew.

#[test]
fn transcripts() {
    trycmd::TestCases::new().case("tests/cmd/*.trycmd");
}
