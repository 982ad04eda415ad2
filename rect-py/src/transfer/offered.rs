//! Wraps the offer of a transfer.
use pyo3::prelude::*;
use rect_core::transfer::{Offer, TransferId};

/// A transfer that was offered and accepted.
#[pyclass(frozen, module = "rect._rect")]
pub struct OfferedTransfer {
    pub(super) id: TransferId,
    pub(super) offer: Offer,
}

#[pymethods]
impl OfferedTransfer {
    /// The id of the transfer.
    #[getter]
    fn id(&self) -> String {
        self.id.to_string()
    }

    #[getter]
    fn sender(&self) -> &str {
        self.offer.sender.as_str()
    }

    #[getter]
    fn topic(&self) -> &str {
        self.offer.topic.as_str()
    }

    #[getter]
    fn name(&self) -> &str {
        self.offer.name.as_str()
    }

    #[getter]
    fn encoding(&self) -> &str {
        self.offer.encoding.as_str()
    }

    #[getter]
    fn size_bytes(&self) -> u64 {
        self.offer.size_bytes
    }
}
