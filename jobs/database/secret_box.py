"""Encrypts secrets that the database stores and that must be read again: those that sign webhooks.

AES-256-GCM with the key of the setting `secret_key`, which is not in the database or its backups. Without that setting
secrets are stored as they are. Stored text is `aes:` and base64 of nonce, ciphertext and tag.
"""

import base64
import os

from jobs.errors import SecretKeyError

PREFIX = "aes:"
NONCE_BYTES = 12


class SecretBox:
    """Encrypts and decrypts with one key of 32 bytes; without a key it encrypts nothing."""

    def __init__(self, key: bytes | None = None) -> None:
        self._key = key

    def encrypt(self, secret: str, owner_id: str) -> str:
        """What to store for a secret of the row `owner_id`; it can be read as that row's only."""
        if self._key is None:
            return secret
        # only services with such a key pay for this import
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM

        nonce = os.urandom(NONCE_BYTES)
        ciphertext = AESGCM(self._key).encrypt(nonce, secret.encode(), owner_id.encode())
        return PREFIX + base64.b64encode(nonce + ciphertext).decode()

    def decrypt(self, stored: str, owner_id: str) -> str:
        """The secret of what was stored, also of what was stored before there was a key.

        Raises:
            SecretKeyError: it was encrypted, and there is no key, or another one.
        """
        if not stored.startswith(PREFIX):
            return stored
        if self._key is None:
            raise SecretKeyError("the secret is encrypted and the setting secret_key is missing; set it as it was")
        from cryptography.exceptions import InvalidTag
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM

        content = base64.b64decode(stored.removeprefix(PREFIX))
        try:
            plain = AESGCM(self._key).decrypt(content[:NONCE_BYTES], content[NONCE_BYTES:], owner_id.encode())
        except InvalidTag:
            raise SecretKeyError(
                "the secret was encrypted with another secret_key; set that one, or make a new endpoint"
            ) from None
        return plain.decode()
