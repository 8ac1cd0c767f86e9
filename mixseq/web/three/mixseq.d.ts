// Types of mixseq.js: the decoder of compressed mesh sequences, and what draws them.

/** An error in a file, in one line. */
export class MixseqError extends Error {}

/** `text` is the text `coding` of a compressed model, `streams` are its streams. Bytes are checked, nothing is decoded yet. */
export function open(text: string, streams: Uint8Array): Promise<Sequence>;

export interface Chunk {
  readonly first: number;
  readonly count: number;
  loaded: boolean;
}

export interface Fields {
  count: number;
  parts: { vertices: Uint32Array; fields: Uint32Array; values: Float32Array | Float64Array }[];
}

export interface Polygons {
  counts: Uint32Array;
  corners: Uint32Array;
}

export interface Facts {
  readonly name: string;
  readonly fps: number;
  readonly upAxis: "X" | "Y" | "Z";
  readonly metresPerUnit: number;
  readonly vertexCount: number;
  readonly polygonCount: number;
  readonly cornerCount: number;
  readonly frameCount: number;
  /** Seconds, one for every frame. */
  readonly times: Float64Array;
  /** Where positions are relative to, x, y and z: that of the node of the mesh in a GLB file. */
  readonly origin: readonly [number, number, number];
  readonly parameters: Record<string, unknown>;
}

export interface Sequence extends Facts {}
export class Sequence {
  readonly chunks: Chunk[];
  polygons(): Polygons;
  /** Three vertices for each triangle. */
  triangles(): Uint32Array;
  fields(): Fields;
  load(chunk: number): void;
  /** Of all fields at a time in seconds: x, y and z of each. */
  weights(time: number, out?: Float32Array): Float32Array;
  /** Positions at a time in seconds, relative to `origin`: x, y and z of each vertex. */
  at<T extends Float32Array | Float64Array = Float32Array>(time: number, out?: T): T;
  frame<T extends Float32Array | Float64Array = Float32Array>(number: number, out?: T): T;
  /** Displacements to add to the fields; null if there are none. */
  residuals(time: number): Float32Array | null;
  /** The decoded mesh, fields and weights of a chunk, for `take` in another thread. */
  share(chunk: number): unknown;
  /** Take the result of `share` of the same sequence, instead of decoding it. */
  take(shared: unknown): void;
}

/** Texture coordinates at the corners, v upwards; null if there are none. */
export function uvsOf(sequence: Sequence): Float32Array | null;

/** Colours at the corners, red, green, blue and alpha, from 0 to 1; null if there are none. */
export function coloursOf(sequence: Sequence): Float32Array | null;

/** Numbers of normals at the corners; null if all corners of a vertex share one. */
export function hardEdgesOf(sequence: Sequence): ArrayLike<number> | null;

/** All other attributes of the polygons, by name. */
export function surfaceOf(sequence: Sequence): Record<string, ArrayLike<number> | string[]>;

export interface DrawnMesh {
  triangles: Uint32Array;
  /** The number of each vertex in the sequence. */
  vertices: Uint32Array;
  /** Those of one group share a normal. */
  groups: Uint32Array;
  /** v downwards. */
  uvs: Float32Array | null;
  /** Red, green, blue and alpha of each. */
  colours: Float32Array | null;
}

/** The mesh for graphics cards, split at seams and hard edges. */
export function drawnMesh(sequence: Sequence): DrawnMesh;
export function takePositions(positions: Float32Array, vertices: Uint32Array, out: Float32Array): Float32Array;
export function takeNormals(positions: Float32Array, triangles: Uint32Array, groups: Uint32Array, out: Float32Array): Float32Array;

export interface Card {
  count: number;
  /** Four floats for each vertex. */
  positions: WebGLBuffer;
  /** Three floats for each vertex. */
  normals: WebGLBuffer;
  evaluate(weights: Float32Array, residuals?: Float32Array | null): void;
}

/** Positions and normals as buffers of the graphics card. */
export function fieldTextures(gl: WebGL2RenderingContext, fields: Fields, triangles: Uint32Array, vertices?: Uint32Array | null, groups?: Uint32Array | null): Card;

/** The mesh sequence of a body in a GLB file, by default the first of its `bodies`. */
export function readGlb(file: ArrayBuffer, body?: string | null): {
  bodies: string[];
  text: string;
  streams: Uint8Array;
  json: any;
  mesh: any;
  matrix: number[];
};

/** Verify that this decoder supports the version of the extension MIXSEQ_mesh_sequence. */
export function checkVersion(extension: { version: number }): void;

export interface RemoteSequence extends Facts {
  polygons(): Promise<Polygons>;
  triangles(): Promise<Uint32Array>;
  fields(): Promise<Fields>;
  load(chunk: number): Promise<void>;
  share(chunk: number): Promise<unknown>;
  drawn(): Promise<DrawnMesh>;
  uvs(): Promise<Float32Array | null>;
  weights(time: number): Promise<Float32Array>;
  residuals(time: number): Promise<Float32Array | null>;
  at(time: number): Promise<Float32Array>;
  frame(number: number): Promise<Float32Array>;
  /** Decode everything; `told` is called with the completed share. */
  decode(told?: (share: number) => void): Promise<void>;
  close(): void;
}

/** Open a sequence in a Worker; `address` is that of mixseq.js, by default its own. */
export function openRemote(text: string, streams: Uint8Array, address?: string): Promise<RemoteSequence>;

/** Open a sequence that a Worker decodes and this thread plays: mesh, fields and first chunk first, then the others. */
export function openDecoded(text: string, streams: Uint8Array, address?: string): Promise<{ sequence: Sequence; drawn: DrawnMesh }>;
