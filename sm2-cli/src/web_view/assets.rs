//! The files of the page. They are part of the program, so the page works without a network.

/// A file of the page.
#[derive(Debug)]
pub(super) struct Asset {
    path: &'static str,
    pub(super) content_type: &'static str,
    pub(super) text: &'static str,
}

macro_rules! asset {
    ($path:literal, $file:literal, $content_type:literal) => {
        Asset {
            path: $path,
            content_type: $content_type,
            text: include_str!(concat!("page/", $file)),
        }
    };
}

const ASSETS: &[Asset] = &[
    asset!("", "index.html", "text/html; charset=utf-8"),
    asset!("style.css", "style.css", "text/css; charset=utf-8"),
    asset!("app.js", "app.js", "text/javascript; charset=utf-8"),
    asset!("dom.js", "dom.js", "text/javascript; charset=utf-8"),
    asset!("domain.js", "domain.js", "text/javascript; charset=utf-8"),
    asset!("layout.js", "layout.js", "text/javascript; charset=utf-8"),
    asset!("graph.js", "graph.js", "text/javascript; charset=utf-8"),
    asset!("panel.js", "panel.js", "text/javascript; charset=utf-8"),
    asset!("tables.js", "tables.js", "text/javascript; charset=utf-8"),
    asset!("text.js", "text.js", "text/javascript; charset=utf-8"),
];

/// The file at a path behind the token.
pub(super) fn find(path: &str) -> Option<&'static Asset> {
    ASSETS.iter().find(|asset| asset.path == path)
}
