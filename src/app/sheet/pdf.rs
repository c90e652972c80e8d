//! Pages as PDF: vectors, and text in a font that every reader has.

use super::page::{Hold, Mark, Page};
use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str};

const POINTS_A_MM: f64 = 72.0 / 25.4;

/// The document. Asks readers not to scale it for the printer.
pub fn pdf(pages: &[Page]) -> Vec<u8> {
    let [catalog, tree, font] = [1, 2, 3].map(Ref::new);
    let ids = |k: usize| [4 + 2 * k as i32, 5 + 2 * k as i32].map(Ref::new);
    let name = Name(b"F1");
    let mut pdf = Pdf::new();
    let mut root = pdf.catalog(catalog);
    root.pages(tree);
    root.viewer_preferences().pair(Name(b"PrintScaling"), Name(b"None"));
    root.finish();
    pdf.pages(tree).kids((0..pages.len()).map(|k| ids(k)[0])).count(pages.len() as i32);
    pdf.type1_font(font).base_font(Name(b"Helvetica"));
    for (k, page) in pages.iter().enumerate() {
        let [id, content] = ids(k);
        let mut head = pdf.page(id);
        let [width, height] = page.size.map(|mm| (mm * POINTS_A_MM) as f32);
        head.media_box(Rect::new(0.0, 0.0, width, height)).parent(tree).contents(content);
        head.resources().fonts().pair(name, font);
        head.finish();
        pdf.stream(content, &marks(page, name));
    }
    pdf.finish()
}

/// The page's marks, drawn in millimetres from the bottom left.
fn marks(page: &Page, font: Name<'_>) -> Vec<u8> {
    let mut out = Content::new();
    let scale = POINTS_A_MM as f32;
    out.transform([scale, 0.0, 0.0, scale, 0.0, 0.0]);
    for mark in &page.marks {
        match mark {
            Mark::Ink(rects) => {
                for &[x, y, w, h] in rects {
                    out.rect(x as f32, (page.size[1] - y - h) as f32, w as f32, h as f32);
                }
                out.fill_nonzero();
            }
            Mark::Text { at: [x, y], size, hold, text } => {
                let left = if *hold == Hold::Middle { x - 0.5 * width(text, *size) } else { *x };
                out.begin_text();
                out.set_font(font, *size as f32);
                out.next_line(left as f32, (page.size[1] - y) as f32);
                out.show(Str(text.as_bytes()));
                out.end_text();
            }
        }
    }
    out.finish().to_vec()
}

/// Roughly how long a line of Helvetica is: figures are .556 wide, letters about as much.
fn width(text: &str, size: f64) -> f64 {
    0.53 * size * text.len() as f64
}
