//! What a person sees: every `.trycmd` file in `tests/cmd` is a session whose output must stay as it is written there.
//! `TRYCMD=overwrite cargo test -p inerter --test transcripts` writes them anew.

#[test]
fn transcripts() {
    let cases = trycmd::TestCases::new();
    cases.case("tests/cmd/*.trycmd");
    if cfg!(feature = "probe") {
        cases.skip("tests/cmd/*.without-probe.trycmd");
    }
}
