//! A look at a page with the browser of the machine: pictures of it, its printed form, and what the browser made of it.

use std::collections::HashSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const TIME_LIMIT: Duration = Duration::from_secs(90);
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];
/// Window sizes: a wide screen with the contents beside the text, and a narrow one with the contents above it.
const WINDOWS: [(&str, [u32; 2]); 2] = [("wide", [1400, 1000]), ("narrow", [600, 900])];

/// Reports what a reader of the page would stumble over. It is only put into a copy of the page.
const PROBE: &str = r##"<script>
let errors = [];
addEventListener("error", e => errors.push(e.message || "not loaded: " + (e.target.src || e.target.href)), true);
addEventListener("securitypolicyviolation", e => errors.push("blocked: " + e.blockedURI));
addEventListener("load", () => {
  let probe = document.createElement("probe");
  let say = (name, value) => probe.setAttribute("data-" + name, value);
  say("mode", document.compatMode);
  say("images", Array.from(document.images, i => i.complete ? i.naturalWidth : 0).join(","));
  say("errors", errors.join("; "));
  say("overflow", document.documentElement.scrollWidth - document.documentElement.clientWidth);
  say("dangling", Array.from(document.querySelectorAll("a[href^='#']"), a => decodeURIComponent(a.hash.slice(1)))
    .filter(id => !document.getElementById(id)).join(","));
  say("twins", Array.from(document.querySelectorAll("[id]"), e => e.id).filter((id, i, all) => all.indexOf(id) < i).join(","));
  document.body.append(probe);
});
</script>"##;

/// What the browser made of a page.
pub struct Screens {
    /// Pictures of the wide and of the narrow window.
    pub windows: [PathBuf; 2],
    pub pdf: PathBuf,
    /// Pages of the PDF.
    pub pages: usize,
    /// Document of the untouched page.
    pub dom: String,
}

/// The browser of this machine.
pub fn browser() -> Option<PathBuf> {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let on_path = std::env::split_paths(&folders).flat_map(|folder| NAMES.map(|name| folder.join(name)));
    std::iter::once(PathBuf::from("/usr/bin/chromium")).chain(on_path).find(|path| path.is_file())
}

/// Opens a page in a browser without a window, checks what every page has to hold, and leaves its pictures and its PDF in `out`.
/// `None`, with a line on standard error, if the machine has no browser.
pub fn screens(html: &Path, out: &Path) -> Option<Screens> {
    let Some(browser) = browser() else {
        eprintln!("skipped: no Chromium to look at {} with", html.display());
        return None;
    };
    let source = fs::read_to_string(html).unwrap();
    fs::create_dir_all(out).unwrap();
    let out = out.canonicalize().unwrap();

    let windows = WINDOWS.map(|(name, size)| {
        let picture = out.join(format!("{name}.png"));
        run(&browser, html, &[&format!("--screenshot={}", picture.display()), &window(size), "--hide-scrollbars"]);
        let colours = colours(&picture, size);
        assert!(colours > 8, "{} is blank: {colours} colours", picture.display());
        picture
    });

    let dom = run(&browser, html, &["--dump-dom"]);
    let figures = source.matches("<img ").count();
    assert_eq!(dom.matches("<img ").count(), figures, "the document lacks pictures");
    assert_eq!(dom.matches("<figure>").count(), source.matches("<figure>").count());

    let copy = out.join("probed.html");
    fs::write(&copy, probed(&source)).unwrap();
    for (name, size) in WINDOWS {
        let dom = run(&browser, &copy, &["--dump-dom", &window(size)]);
        let said = |what: &str| attribute(&dom, &format!("data-{what}"));
        assert_eq!(said("mode"), "CSS1Compat", "{name}");
        assert_eq!(said("errors"), "", "{name}");
        assert_eq!(said("overflow"), "0", "{name}: the page is wider than the window");
        assert_eq!(said("dangling"), "", "{name}: links lead nowhere");
        assert_eq!(said("twins"), "", "{name}: an id is given twice");
        let widths: Vec<u32> = said("images").split(',').filter(|w| !w.is_empty()).map(|w| w.parse().unwrap()).collect();
        assert_eq!(widths.len(), figures, "{name}");
        assert!(widths.iter().all(|w| *w > 0), "{name}: pictures that do not load: {widths:?}");
    }
    fs::remove_file(&copy).unwrap();

    let pdf = out.join("page.pdf");
    run(&browser, html, &[&format!("--print-to-pdf={}", pdf.display()), "--no-pdf-header-footer"]);
    let bytes = fs::read(&pdf).unwrap();
    assert!(bytes.starts_with(b"%PDF"));
    let pages = pages(&bytes);
    let chapters = source.matches("<section class=\"chapter\"").count();
    assert!(pages >= chapters.max(1), "{pages} pages for {chapters} chapters");
    Some(Screens { windows, pdf, pages, dom })
}

fn window([width, height]: [u32; 2]) -> String {
    format!("--window-size={width},{height}")
}

/// Opens a page and gives what the browser prints. A browser that takes too long is ended together with its helpers.
fn run(browser: &Path, html: &Path, options: &[&str]) -> String {
    // The copy of the browser's files goes away with the folder, and no two runs share one.
    let own = tempfile::tempdir().unwrap();
    let printed = own.path().join("stdout");
    let log = own.path().join("stderr");
    let mut command = Command::new(browser);
    command
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
        ])
        .args(["--disable-component-update", "--disable-sync", "--disable-extensions", "--disable-dev-shm-usage"])
        .arg(format!("--user-data-dir={}", own.path().join("profile").display()))
        .args(options)
        .arg(format!("file://{}", html.canonicalize().unwrap().display()))
        .stdin(Stdio::null())
        .stdout(File::create(&printed).unwrap())
        .stderr(File::create(&log).unwrap());
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let mut child = command.spawn().unwrap();
    let begin = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if begin.elapsed() > TIME_LIMIT {
            let _ = Command::new("kill").args(["-9", "--", &format!("-{}", child.id())]).status();
            let _ = child.kill();
            let _ = child.wait();
            panic!("no answer within {TIME_LIMIT:?} to {options:?}: {}", fs::read_to_string(&log).unwrap_or_default());
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    assert!(status.success(), "{status} to {options:?}: {}", fs::read_to_string(&log).unwrap_or_default());
    fs::read_to_string(&printed).unwrap()
}

/// The page with the probe, and without the rule that forbids scripts.
fn probed(source: &str) -> String {
    let free = match source.find("<meta http-equiv=\"Content-Security-Policy\"") {
        None => source.to_owned(),
        Some(at) => {
            let end = at + source[at..].find('>').unwrap() + 1;
            format!("{}{}", &source[..at], &source[end..])
        }
    };
    let at = free.find("<head>").expect("a page has a head") + "<head>".len();
    format!("{}{PROBE}{}", &free[..at], &free[at..])
}

fn attribute(dom: &str, name: &str) -> String {
    let probe = &dom[dom.find("<probe ").expect("the probe has run")..];
    let begin = probe.find(&format!("{name}=\"")).expect("the probe says everything") + name.len() + 2;
    let end = begin + probe[begin..].find('"').unwrap();
    probe[begin..end].to_owned()
}

/// Different colours of a picture of a window.
fn colours(picture: &Path, size: [u32; 2]) -> usize {
    let decoder = png::Decoder::new(std::io::BufReader::new(File::open(picture).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!([info.width, info.height], size);
    let samples = info.color_type.samples();
    pixels[..info.buffer_size()].chunks(samples).collect::<HashSet<_>>().len()
}

/// Pages of a PDF whose page objects are not compressed, as Chromium writes them.
fn pages(pdf: &[u8]) -> usize {
    let mark = b"/Type /Page";
    pdf.windows(mark.len() + 1).filter(|w| w.starts_with(mark) && w[mark.len()] != b's').count()
}
