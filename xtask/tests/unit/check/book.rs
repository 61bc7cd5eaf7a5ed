//! Unit tests of `check::book`.

use super::*;

fn document(text: &str) -> Document {
    Document { path: "docs/page.md".into(), text: text.into() }
}

#[test]
fn headings_have_the_anchors_of_github() {
    let page = document("# A: `b_c` & d\n\n## Twice\n\n## Twice\n\n```sh\n# no heading\n```\n");
    let anchors: Vec<_> = anchors_of(&page).into_iter().collect();
    assert_eq!(anchors, ["a-b_c--d", "twice", "twice-1"]);
}

#[test]
fn links_are_found_in_text_tables_and_references_and_not_in_code() {
    let page = document("[a](x.md#y), [b], ![c](d.svg)\n\n| t |\n| --- |\n| [e](f.md) |\n\n`[g](h)`\n\n[b]: ../z\n");
    let links: Vec<_> = links(&page).into_iter().map(|(_, link)| link).collect();
    assert_eq!(links, ["x.md#y", "../z", "d.svg", "f.md"]);
    assert_eq!(normal(Path::new("docs/guide/../../gdp/./README.md")), Path::new("gdp/README.md"));
}

#[test]
fn a_block_says_what_it_is() {
    let found = |text: &str| document(text).blocks().iter().filter_map(problem).count();
    assert_eq!(found("```\nx\n```\n"), 1);
    assert_eq!(found("```console\n$ ls\n```\n"), 1);
    assert_eq!(found("```console\nrobot7$ ls\na\n```\n"), 0);
    assert_eq!(found("```yaml\nversion: 1\n```\n\n```yaml\n# gdp.yaml\nrib: true\n```\n"), 1);
}
