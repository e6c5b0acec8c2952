// Pulls that the service answers: /v1/interact/stream.

/** A source for page/hand.js: the service's oscillators of one spectrum. */
export const remoteSource = (client, spectrumId) => ({ push: (options) => client.push(spectrumId, options) });
