//! A store in S3-compatible storage.
//!
//! Credentials, region and address come from the usual variables: `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`,
//! `AWS_ENDPOINT`, and `AWS_ALLOW_HTTP` for a server without TLS.

use std::{
    io::{self, Read},
    path::PathBuf,
    time::Duration,
};

use futures_util::TryStreamExt;
use object_store::{
    ObjectStore, ObjectStoreExt, PutPayload, RetryConfig,
    aws::{AmazonS3, AmazonS3Builder},
    path::Path,
};
use tokio::runtime::{Builder, Runtime};

use crate::files::Files;

/// Bytes that go at once; S3 wants 5 MiB of each part but the last one.
const PART: usize = 8 << 20;
/// A server that is busy is asked again for so long.
const PATIENCE: Duration = Duration::from_secs(20);

/// Objects below a prefix.
pub(crate) struct Bucket {
    objects: AmazonS3,
    prefix: String,
    runtime: Runtime,
}

impl Bucket {
    /// `BUCKET` or `BUCKET/FOLDER`.
    pub(crate) fn new(address: &str) -> io::Result<Self> {
        let (bucket, prefix) = address.split_once('/').unwrap_or((address, ""));
        let retry = RetryConfig { max_retries: 4, retry_timeout: PATIENCE, ..RetryConfig::default() };
        let objects = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(retry).build();
        Ok(Self {
            objects: objects.map_err(plain)?,
            prefix: prefix.trim_matches('/').into(),
            runtime: Builder::new_current_thread().enable_all().build()?,
        })
    }

    fn path(&self, name: &str) -> Path {
        Path::from(if self.prefix.is_empty() { name.to_owned() } else { format!("{}/{name}", self.prefix) })
    }
}

impl Files for Bucket {
    fn put(&self, name: &str, from: &mut dyn Read, length: u64) -> io::Result<()> {
        if self.has(name)? {
            return Ok(());
        }
        let path = self.path(name);
        let part = |from: &mut dyn Read| {
            let mut bytes = Vec::new();
            from.take(PART as u64).read_to_end(&mut bytes)?;
            io::Result::Ok(bytes)
        };
        self.runtime.block_on(async {
            // Read to its very end in any case: that is where a reader may refuse.
            if length < PART as u64 {
                let bytes = part(from)?;
                return self.objects.put(&path, PutPayload::from(bytes)).await.map(drop).map_err(plain);
            }
            let mut upload = self.objects.put_multipart(&path).await.map_err(plain)?;
            let sent = async {
                loop {
                    let bytes = part(from)?;
                    if bytes.is_empty() {
                        return io::Result::Ok(());
                    }
                    upload.put_part(PutPayload::from(bytes)).await.map_err(plain)?;
                }
            };
            match sent.await {
                Ok(()) => upload.complete().await.map(drop).map_err(plain),
                Err(error) => {
                    // Parts that stay cost money, and no more can be done about them.
                    upload.abort().await.ok();
                    Err(error)
                }
            }
        })
    }

    fn read(&self, name: &str, take: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
        self.runtime.block_on(async {
            let mut parts = self.objects.get(&self.path(name)).await.map_err(plain)?.into_stream();
            while let Some(part) = parts.try_next().await.map_err(plain)? {
                take(&part)?;
            }
            Ok(())
        })
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let under = self.path(folder);
        let mut names = self.runtime.block_on(async {
            let objects = self.objects.list(Some(&under)).map_ok(|object| object.location.to_string());
            objects.try_collect::<Vec<_>>().await.map_err(plain)
        })?;
        for name in &mut names {
            if let Some(short) = name.strip_prefix(&self.prefix) {
                *name = short.trim_start_matches('/').to_owned();
            }
        }
        names.sort();
        Ok(names)
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        match self.runtime.block_on(self.objects.delete(&self.path(name))) {
            Err(object_store::Error::NotFound { .. }) => Ok(()),
            removed => removed.map_err(plain),
        }
    }

    fn file(&self, _name: &str) -> Option<PathBuf> {
        None
    }

    fn has(&self, name: &str) -> io::Result<bool> {
        match self.runtime.block_on(self.objects.head(&self.path(name))) {
            Ok(_) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(plain(error)),
        }
    }
}

/// As the system would say it.
fn plain(error: object_store::Error) -> io::Error {
    let kind = match &error {
        object_store::Error::NotFound { .. } => io::ErrorKind::NotFound,
        object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. } => {
            io::ErrorKind::PermissionDenied
        }
        _ => io::ErrorKind::Other,
    };
    io::Error::new(kind, error)
}
