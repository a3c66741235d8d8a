"""What tests of USD scenes share."""


def pairs(scene):
    """Return the pairs that collide; no contact lists one of another."""
    found = [
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    ]
    assert len(found) == len(set(found))
    return set(found)
