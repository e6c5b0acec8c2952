// Pushes that the service answers: /v1/interact/stream.

/** A source for page/hand.js: the service's oscillators of one spectrum with V voxels. */
export const remoteSource = (client, spectrumId, V) => ({
  push: (options) => client.push(spectrumId, options),
  reach: async (locality) => (locality ? client.reach(spectrumId, locality) : new Float32Array(V).fill(1)),
});
