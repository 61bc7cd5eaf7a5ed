//! An index of this node's publications by name and by topic.

use std::collections::HashMap;
use std::sync::Arc;

use gdp_wire::Name;
use parking_lot::Mutex;

use super::publication::Publication;
use gdp_e2e::transport::TopicId;

/// Its lock is released before a publication is used.
#[derive(Default)]
pub struct Publications(Mutex<Index>);

#[derive(Default)]
struct Index {
    by_name: HashMap<Name, Arc<Publication>>,
    by_topic: HashMap<TopicId, Arc<Publication>>,
}

impl Publications {
    pub fn insert(&self, publication: Arc<Publication>) {
        let index = &mut *self.0.lock();
        index.by_topic.insert(publication.topic(), publication.clone());
        index.by_name.insert(publication.name, publication);
    }

    pub fn remove(&self, name: &Name) -> Option<Arc<Publication>> {
        let index = &mut *self.0.lock();
        let removed = index.by_name.remove(name)?;
        index.by_topic.remove(&removed.topic());
        Some(removed)
    }

    pub fn get(&self, name: &Name) -> Option<Arc<Publication>> {
        self.0.lock().by_name.get(name).cloned()
    }

    pub fn of(&self, topic: TopicId) -> Option<Arc<Publication>> {
        self.0.lock().by_topic.get(&topic).cloned()
    }

    pub fn all(&self) -> Vec<Arc<Publication>> {
        self.0.lock().by_name.values().cloned().collect()
    }
}
