//! Writes a video to Matroska files, which FFmpeg, VLC and mpv play. A file is complete after every frame, so that a program that
//! is killed loses nothing.
use std::{
    fs::File,
    path::{Path, PathBuf},
    time::Duration,
};

use rect_core::{
    storage::regular_file,
    video::bitstream::{is_key_frame, kind, units, Parameters},
};
use webm_iterable::{
    errors::TagWriterError,
    matroska_spec::{Master, MatroskaSpec as Tag},
    WebmWriter, WriteOptions,
};

/// The longest time that a cluster covers: the times in it have 16 bits, in milliseconds.
const CLUSTER: Duration = Duration::from_secs(30);
/// The track's type: video.
const VIDEO: u64 = 1;
/// Nanoseconds of the unit of all times.
const UNIT_NS: u64 = 1_000_000;

/// The files of one video. A picture of another size begins another file, because players expect one size for each.
pub struct VideoFile {
    path: PathBuf,
    open: Option<Open>,
    files: u32,
    frames: u64,
    needs_key: bool,
}

struct Open {
    writer: WebmWriter<File>,
    parameters: Parameters,
    began_at: Duration,
    /// The time of the current cluster, in milliseconds from the beginning of the file.
    cluster_ms: Option<u64>,
    last_ms: Option<u64>,
}

impl VideoFile {
    /// Checks the name of the file, which is created with the first key frame.
    ///
    /// # Errors
    /// Fails if the name does not end in `.mkv`.
    pub fn new(path: PathBuf) -> Result<Self, String> {
        if path.extension().is_none_or(|extension| extension != "mkv") {
            let name = path.display();
            return Err(format!(
                "{name}: a video is saved as Matroska; choose a name that ends in .mkv"
            ));
        }
        Ok(Self {
            path,
            open: None,
            files: 0,
            frames: 0,
            needs_key: true,
        })
    }

    /// Handles that frames are missing: those up to the next key frame are left out.
    pub fn on_gap(&mut self) {
        self.needs_key = true;
    }

    /// Adds a frame, which was taken at that time. Frames before the first key frame are left out.
    ///
    /// # Errors
    /// Fails if the disk does, or there is a file of that name.
    pub fn add(&mut self, frame: &[u8], at: Duration) -> Result<(), String> {
        let is_key = is_key_frame(frame);
        self.needs_key &= !is_key;
        if self.needs_key {
            return Ok(());
        }
        let parameters = Parameters::of(frame);
        if let Some(parameters) = parameters.filter(|_| is_key) {
            let is_same = |open: &Open| open.parameters == parameters;
            if !self.open.as_ref().is_some_and(is_same) {
                self.begin(parameters, at)?;
            }
        }
        let path = self.current();
        let Some(open) = &mut self.open else {
            return Ok(());
        };
        let named = |error: TagWriterError| format!("{}: {error}", path.display());
        open.add(frame, is_key, at).map_err(named)?;
        self.frames += 1;
        Ok(())
    }

    /// Returns how many frames and files were written.
    pub fn written(&self) -> (u64, u32) {
        (self.frames, self.files)
    }

    fn begin(&mut self, parameters: Parameters, at: Duration) -> Result<(), String> {
        self.files += 1;
        let path = self.current();
        let named = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let file = regular_file::create_new(&path).map_err(|error| named(&error))?;
        let open = Open::begin(file, parameters, at).map_err(|error| named(&error))?;
        self.open = Some(open);
        Ok(())
    }

    /// Returns the name of the current file: `match.mkv`, then `match-2.mkv`.
    fn current(&self) -> PathBuf {
        match self.files {
            0 | 1 => self.path.clone(),
            number => numbered(&self.path, number),
        }
    }
}

fn numbered(path: &Path, number: u32) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{number}.mkv"))
}

impl Open {
    fn begin(file: File, parameters: Parameters, at: Duration) -> Result<Self, TagWriterError> {
        let mut writer = WebmWriter::new(file);
        let program = format!("rect {}", env!("CARGO_PKG_VERSION"));
        writer.write(&Tag::Ebml(Master::Full(vec![
            Tag::DocType("matroska".to_owned()),
            Tag::DocTypeVersion(4),
            Tag::DocTypeReadVersion(2),
        ])))?;
        writer.write_advanced(
            &Tag::Segment(Master::Start),
            WriteOptions::is_unknown_sized_element(),
        )?;
        writer.write(&Tag::Info(Master::Full(vec![
            Tag::TimestampScale(UNIT_NS),
            Tag::MuxingApp(program.clone()),
            Tag::WritingApp(program),
        ])))?;
        writer.write(&Tag::Tracks(Master::Full(vec![Tag::TrackEntry(
            Master::Full(vec![
                Tag::TrackNumber(1),
                Tag::TrackUID(1),
                Tag::TrackType(VIDEO),
                Tag::FlagLacing(0),
                Tag::CodecID("V_MPEG4/ISO/AVC".to_owned()),
                Tag::CodecPrivate(configuration(&parameters)),
                Tag::Video(Master::Full(vec![
                    Tag::PixelWidth(parameters.width.into()),
                    Tag::PixelHeight(parameters.height.into()),
                ])),
            ]),
        )])))?;
        Ok(Self {
            writer,
            parameters,
            began_at: at,
            cluster_ms: None,
            last_ms: None,
        })
    }

    fn add(&mut self, frame: &[u8], is_key: bool, at: Duration) -> Result<(), TagWriterError> {
        let passed = at.saturating_sub(self.began_at).as_millis();
        let passed = u64::try_from(passed).unwrap_or(u64::MAX);
        // Each frame is later than the one before, however the clocks are corrected.
        let at_ms = self.last_ms.map_or(0, |last| passed.max(last + 1));
        self.last_ms = Some(at_ms);
        let in_cluster = |start: u64| at_ms - start;
        let fits = |start: &u64| !is_key && u128::from(in_cluster(*start)) < CLUSTER.as_millis();
        let start = match self.cluster_ms.filter(fits) {
            Some(start) => start,
            None => {
                if self.cluster_ms.is_some() {
                    self.writer.write(&Tag::Cluster(Master::End))?;
                }
                self.writer.write_advanced(
                    &Tag::Cluster(Master::Start),
                    WriteOptions::is_unknown_sized_element(),
                )?;
                self.writer.write(&Tag::Timestamp(at_ms))?;
                self.cluster_ms = Some(at_ms);
                at_ms
            }
        };
        let time = i16::try_from(at_ms - start).unwrap_or(i16::MAX);
        let flags: u8 = if is_key { 0x80 } else { 0 };
        let mut block = vec![0x81];
        block.extend_from_slice(&time.to_be_bytes());
        block.push(flags);
        // The parameters are in the track.
        for unit in units(frame).filter(|unit| !matches!(kind(unit), 7..=9)) {
            push(&mut block, unit);
        }
        // Nothing of known size is open, so that the writer passes each element to the file at once.
        self.writer.write(&Tag::SimpleBlock(block))
    }
}

/// Appends a unit after its length.
fn push(block: &mut Vec<u8>, unit: &[u8]) {
    let length = u32::try_from(unit.len()).unwrap_or(u32::MAX);
    block.extend_from_slice(&length.to_be_bytes());
    block.extend_from_slice(unit);
}

/// Returns the parameters in the form of ISO/IEC 14496-15, section 5.3.3.1, with lengths of 4 bytes.
fn configuration(parameters: &Parameters) -> Vec<u8> {
    let Parameters {
        sequence, picture, ..
    } = parameters;
    let mut bytes = vec![1];
    // The profile and the level, which are the first bytes after the kind.
    bytes.extend_from_slice(sequence.get(1..4).unwrap_or(&[66, 0, 30]));
    bytes.push(0xff);
    for (count, unit) in [(0xe1, sequence), (1, picture)] {
        bytes.push(count);
        let length = u16::try_from(unit.len()).unwrap_or(u16::MAX);
        bytes.extend_from_slice(&length.to_be_bytes());
        bytes.extend_from_slice(unit);
    }
    bytes
}
